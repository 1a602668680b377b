"""How well candidates are ranked: python -m dpc_jax.measure.candidate_ranking WORKDIR

On batches of a run, with its last checkpoint, all candidates are compared exactly, and
ranked in a smaller volume or in an image. It prints a Markdown table: how often the
exact winner is among the first one to four, and by how much the loss of the best of
these exceeds the winner's, on average.
"""

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from dpc_jax.config import Config, replace_fields
from dpc_jax.data import DataSet, load_or_render
from dpc_jax.data.batches import choose_batch, read_batch
from dpc_jax.learning import schedules
from dpc_jax.learning.choice.coarse_choice import (
    compute_coarse_losses,
    compute_image_losses,
    place_candidates,
)
from dpc_jax.learning.losses import downsample_images
from dpc_jax.learning.predictions import encode_views, predict_poses, predict_shapes
from dpc_jax.learning.renders import compute_candidate_losses, make_scenes
from dpc_jax.learning.step import TrainState
from dpc_jax.render import Camera
from dpc_jax.reporting.tables import format_table
from dpc_jax.run.finished import restore_state
from dpc_jax.run.setup import make_data_specs, make_network
from dpc_jax.run.workdir import read_config

WAYS = (("volume", 16, 500), ("image", 16, 500), ("image", 32, 250))
WAYS = (*WAYS, ("image", 32, 500), ("image", 32, 1000))  # rank, side, points
TOPS = (1, 2, 3, 4)


def make_ranker(config: Config, step: int) -> Callable:
    """The compiled function (state, batch, key) -> losses [1 + ways, B·V, C].

    The first are the exact ones, the others those by which each of WAYS ranks.
    """
    render, network = config.render, make_network(config)
    sigma = schedules.compute_sigma(step, render, steps=config.train.steps)
    stage = schedules.find_stage(step, render, steps=config.train.steps)
    camera = Camera(render.focal_length, render.distance)

    def compare(view):
        scene, candidates, target = view
        yield compute_candidate_losses(scene, candidates, target, camera=camera)
        for rank, side, count in WAYS:
            if rank == "volume":
                yield compute_coarse_losses(
                    scene,
                    candidates,
                    target,
                    camera=camera,
                    choice_grid=side,
                    choice_points=count,
                    renders_at_once=1,
                )
            else:
                places = place_candidates(
                    scene["points"],
                    candidates,
                    side=side,
                    camera=camera,
                    choice_points=count,
                    size=scene["sigma"],
                )
                yield compute_image_losses(
                    places,
                    scene["mass"],
                    target,
                    sigma=scene["sigma"],
                    choice_grid=side,
                )

    def rank(state, batch, key):
        features = encode_views(
            state.params, batch["images"], batch["masks"], network=network
        )
        shapes = predict_shapes(
            state.params,
            features[:, 0],
            jax.random.split(key, len(features)),
            sigma,
            network=network,
            kept_points=stage.kept_points,
            scale_unit=render.scale_unit,
            grid=render.grid,
        )
        poses = predict_poses(
            state.params, features, state.covariance, network=network, pose=config.pose
        )
        views = features.shape[1]
        targets = downsample_images(batch["masks"], render.grid)
        scene, shared = make_scenes(shapes)
        inputs = (
            {name: jnp.repeat(a, views, axis=0) for name, a in scene.items()},
            poses.candidates,
            targets.reshape(-1, *targets.shape[2:]),
        )

        def compare_all(view):
            scene, *rest = view
            return jnp.stack(list(compare((scene | shared, *rest))))

        losses = jax.lax.map(compare_all, inputs)
        return jnp.swapaxes(losses, 0, 1)

    return jax.jit(rank)


def check_ranked(config: Config, workdir: Path):
    """Refuse runs without candidates, or of shapes that are no points.

    Raises:
      ValueError: for these.
    """
    heads, shape = config.pose.heads, config.network.shape
    if heads < 2 or shape != "points":
        raise ValueError(
            f"Expected a run of points with several pose heads in {workdir}, but it "
            f"has {heads} heads and predicts {shape}; give another."
        )


def measure_ranking(
    config: Config, state: TrainState, dataset: DataSet, *, step: int, batches: int
) -> list[tuple[np.ndarray, np.ndarray]]:
    """(share of winners found, mean excess of the loss) of each way and number kept."""
    rank, train, parts = make_ranker(config, step), config.train, []
    for number in range(batches):
        chosen = choose_batch(
            len(dataset.counts),
            dataset.counts,
            seed=config.seed,
            step=step + number,
            models_per_batch=train.models_per_batch,
            views_per_batch=train.views_per_batch,
        )
        batch = read_batch(dataset, *chosen)
        parts.append(rank(state, batch, jax.random.key(number)))
    exact, *ways = np.concatenate(parts, axis=1)
    found = []
    for losses in ways:
        order = np.argsort(losses, axis=1)
        kept = [np.take_along_axis(exact, order[:, :top], 1).min(1) for top in TOPS]
        excess = np.array(kept) / exact.min(1) - 1
        found.append((np.mean(excess == 0, axis=1), np.mean(excess, axis=1)))
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse the command line, measure, print."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("workdir", type=Path)
    parser.add_argument("--batches", type=int, default=16)
    parser.add_argument("--cache_dir", help="of the data; by default the run's")
    flags = parser.parse_args(arguments)
    try:
        config = replace_fields(read_config(flags.workdir), {"run": {"devices": 0}})
        check_ranked(config, flags.workdir)
        state = restore_state(config, flags.workdir)
        spec = make_data_specs(config)["train"]
        cache_dir = flags.cache_dir or config.data.cache_dir
        dataset = load_or_render(spec, cache_dir=cache_dir)
        step = min(int(state.step), config.train.steps - 1)
        found = measure_ranking(
            config, state, dataset, step=step, batches=max(1, flags.batches)
        )
    except (ValueError, OSError) as error:
        print(f"Error: {error}", file=sys.stderr)
        return 1
    heads = ("ranked in", "side", "points", *(f"first {top}" for top in TOPS))
    rows = [
        (
            *map(str, way),
            *(
                f"{share:.3f} ({excess:.2%})"
                for share, excess in zip(*result, strict=True)
            ),
        )
        for way, result in zip(WAYS, found, strict=True)
    ]
    print(format_table(heads, rows, align="lrr" + "r" * len(TOPS)), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
