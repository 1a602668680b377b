"""§ Interpolation of shapes in the latent space: from one test image to another.

The latent space is, as in the paper, the first dense layer of the encoder, which shape
and pose share: its activations are mixed, and the rest of the network makes a cloud of
the mixture. The paper shows strips; here the steps between are also measured.
"""

from pathlib import Path

import numpy as np

from dpc_jax.experiments.correspondences import read_first_views
from dpc_jax.reporting import paper_figures
from dpc_jax.run.trained import TrainedNetwork, load_split, load_trained, predict_points

PAIRS = 12  # of test images that are measured
DRAWN = 6  # of them, as in the paper
STEPS = 20  # from one image to the other
COLUMNS = 5  # clouds of a drawn pair, its ends among them
LARGEST_STEP = "Largest step over the mean step (1: steady)"


def run(out: Path, workdir: Path) -> tuple[dict[str, float], list[tuple[Path, str]]]:
    """Interpolate between test images of a finished run, measure and draw it.

    Args:
      out: folder of the figures. workdir: of the run.

    Returns:
      The measure by its name, and the figure with its caption.
    """
    finished = load_trained(workdir)
    images, masks = read_first_views(load_split(finished, "test"))
    pairs = draw_pairs(len(images))
    ways = np.array([interpolate(finished, images[p], masks[p]) for p in pairs])
    shown, columns = pairs[:DRAWN], np.linspace(0, STEPS, COLUMNS).astype(int)
    starts, stops = images[shown[:, 0]], images[shown[:, 1]]
    strip = out / "interpolation.png"
    paper_figures.draw_strips(starts, ways[:DRAWN, columns], stops, strip)
    caption = "Shapes between two test images, mixed in the first shared layer."
    return {LARGEST_STEP: measure_steps(ways)}, [(strip, caption)]


def draw_pairs(count: int) -> np.ndarray:
    """Pairs [P, 2] of `count` images, seed 0; none is in two of them."""
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
