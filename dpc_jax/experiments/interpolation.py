"""§ Interpolation of shapes in the latent space: from one test image to another.

The latent space is, as in the paper, the first dense layer of the encoder, which shape
and pose share: its activations are mixed, and the rest of the network makes a cloud of
the mixture. The paper shows strips; here the way between is also measured.
"""

from pathlib import Path

import numpy as np

from dpc_jax.data import DataSet
from dpc_jax.evaluation.chamfer import chamfer_distance, spread_rows
from dpc_jax.experiments.correspondences import read_first_views
from dpc_jax.reporting import paper_figures
from dpc_jax.run.trained import TrainedNetwork, load_split, load_trained, predict_points

PAIRS = 12  # of test images that are measured
DRAWN = 6  # of them, as in the paper
STEPS = 20  # from one image to the other
COLUMNS = 5  # clouds of a drawn pair, its ends among them
CLOSEST = 5  # true shapes that are compared exactly
SURFACE_POINTS = 2000  # of each true shape that clouds are compared with
MEASURES = (
    "Largest step over the mean step (1: steady)",
    "Chamfer distance (×100) to the nearest other shape: the ends",
    "… of what is halfway",
)


def run(
    out: Path, workdir: Path
) -> tuple[dict[str, float | None], list[tuple[Path, str]]]:
    """Interpolate between test images of a finished run, measure and draw it.

    Args:
      out: folder of the figures.
      workdir: of a finished run, with known poses or without.

    Returns:
      The measures by their names, and the figure with its caption.

    Raises:
      ValueError: where the workdir holds no finished run, or too few test images.
      OSError: where files cannot be written.
    """
    finished = load_trained(Path(workdir))
    dataset = load_split(finished, "test")
    images, masks = read_first_views(dataset)
    pairs = draw_pairs(len(images))
    ways = np.array([interpolate(finished, images[p], masks[p]) for p in pairs])
    found = measure_steps(ways), *measure_between(ways, pairs, dataset)
    measures: dict[str, float | None] = dict(zip(MEASURES, found, strict=True))

    shown, columns = pairs[:DRAWN], np.linspace(0, STEPS, COLUMNS).astype(int)
    starts, stops = images[shown[:, 0]], images[shown[:, 1]]
    strip = out / "interpolation.png"
    paper_figures.draw_strips(starts, ways[:DRAWN, columns], stops, strip)
    caption = "Shapes between two test images, mixed in the first shared layer."
    return measures, [(strip, caption)]


def draw_pairs(count: int) -> np.ndarray:
    """Pairs [P, 2] of different ones of `count` images, seed 0; none is in two pairs.

    Raises:
      ValueError: where there are fewer than two images.
    """
    if count < 2:
        raise ValueError(
            f"Expected at least two test images to go between, but there are {count}; "
            "give a run with more --config.data.test_models."
        )
    order = np.random.default_rng(0).permutation(count)
    return order[: 2 * min(PAIRS, count // 2)].reshape(-1, 2)


def interpolate(
    run: TrainedNetwork, images: np.ndarray, masks: np.ndarray
) -> np.ndarray:
    """Clouds [STEPS + 1, N, 3] in the object frame, from one image to another.

    Args:
      images: uint8 [2, S, S, 3]. masks: [2, S, S].
    """
    share = np.linspace(0.0, 1.0, STEPS + 1)
    mix = np.stack([1.0 - share, share], axis=1)
    return predict_points(run, images, masks, mix=mix)


def measure_steps(ways: np.ndarray) -> float:
    """How evenly the points move on their ways [P, F, N, 3]: a mean over pairs.

    The frame that moves points most, over the mean frame; 1 is steady, F - 1 a jump.
    """
    steps = np.linalg.norm(np.diff(ways, axis=1), axis=-1).mean(axis=-1)  # [P, F - 1]
    return float(np.mean(steps.max(axis=1) / steps.mean(axis=1)))


def measure_between(
    ways: np.ndarray, pairs: np.ndarray, dataset: DataSet
) -> tuple[float | None, float | None]:
    """Chamfer distance ×100 of the ends of the ways and of their middles, means.

    Each to the nearest true shape of the set, the two of the pair left out: whether
    what lies halfway is still a shape of the kind. None where there are no true shapes.
    """
    if dataset.surfaces is None or len(dataset.names) < 3:
        return None, None
    surfaces = [
        spread_rows(surface, min(SURFACE_POINTS, len(surface)))
        for surface in dataset.surfaces
    ]
    rows = []
    for way, pair in zip(ways, pairs, strict=True):
        others = [surface for i, surface in enumerate(surfaces) if i not in pair]
        clouds = way[0], way[-1], way[len(way) // 2]
        first, last, halfway = (_find_nearest(cloud, others) for cloud in clouds)
        rows.append(((first + last) / 2, halfway))
    ends, middle = np.mean(rows, axis=0).tolist()
    return ends, middle


def _find_nearest(cloud, surfaces) -> float:
    """Chamfer distance ×100 from a cloud to the nearest of the surfaces.

    An eighth of the points finds the few that may be the nearest.
    """
    rough = [chamfer_distance(cloud[::8], s[::8]).chamfer for s in surfaces]
    best = np.argsort(rough)[:CLOSEST]
    return 100 * min(chamfer_distance(cloud, surfaces[i]).chamfer for i in best)
