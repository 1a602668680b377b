"""Tiny configs, networks, batches and data sets, shared by the tests of learning."""

import contextlib
import dataclasses
import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from data_trees import DISTANCE, FOCAL_LENGTH, project_points

from dpc_jax.config import Config, replace_fields, to_json
from dpc_jax.data import DataSet
from dpc_jax.learning.recipe import Averages, Recipe
from dpc_jax.learning.schedules import find_stage
from dpc_jax.learning.step import TrainState, init_state, make_train_step
from dpc_jax.learning.training.checkpoints import Checkpoints
from dpc_jax.networks import ShapePoseNetwork
from dpc_jax.run.setup import make_network as make_network

IMAGE_SIZE = 16  # pixels, the smallest that the encoder takes
make_state = init_state  # at step 0

# The plain method of the paper in miniature; every extra is off.
PLAIN = {
    "data": dict(image_size=IMAGE_SIZE),
    "render": dict(
        grid=8,
        fine_grid=0,
        num_points=24,
        sigma_start=0.1,
        sigma_end=0.05,
        anneal_until=1.0,
        keep_start=0.625,
        keep_end=0.625,
        focal_length=FOCAL_LENGTH,
        distance=DISTANCE,
        renders_at_once=99,
    ),
    "pose": dict(
        head="quaternion",
        num_heads=3,
        flips=False,
        student="regresses",
        choice_top=0,
        common_frame="",
        student_weight=0.01,
    ),
    "train": dict(
        steps=20,
        models_per_batch=2,
        views_per_batch=2,
        learning_rate=1e-3,
        optimizer="adam",
        framed_views=False,
        spread_masks=False,
        pull_weight=0.0,
        repulsion_weight=0.0,
        containment_weight=0.0,
        color_weight=0.0,
        colors_move_points=True,
    ),
    "log": dict(every=1),
    "run": dict(devices=1),
    "network": dict(channels=2, hidden=12, shape_hidden=12) | dict(sees_mask=False),
}


def tiny_config(*, seed: int = 0, **changes) -> Config:
    """The plain config with other values; a field is named without its section."""
    config = replace_fields(Config("car", seed=seed), PLAIN)
    for section in PLAIN:
        names = {field.name for field in dataclasses.fields(getattr(config, section))}
        asked = {name: changes.pop(name) for name in names & changes.keys()}
        config = replace_fields(config, {section: asked})
    assert not changes, f"no such fields: {changes}"
    return config


def make_recipe(config: Config, network: ShapePoseNetwork | None = None) -> Recipe:
    """What is static about the config's steps."""
    network = network or make_network(config)
    sections = config.render, config.pose, config.train
    return Recipe(network, *sections, config.spreads_masks)


def make_small_state(step: int) -> TrainState:
    """A state with every kind of leaf that a run has."""
    rng = np.random.default_rng(step)
    return TrainState(
        step=jnp.asarray(step, jnp.int32),
        params={"params": {"a": jnp.array(rng.normal(size=(30, 40)), jnp.float32)}},
        optimizer=(jnp.asarray(step, jnp.int32), {"mu": jnp.full((5,), 1e-30)}),
        averages=Averages(jnp.eye(3) * step, jnp.asarray(step / 16)),
    )


def make_step(network: ShapePoseNetwork, config: Config, *, step: int = 0):
    """The compiled step that the loop would take at a step."""
    stage = find_stage(step, config.render, steps=config.train.steps)
    return make_train_step(network, config, stage)


def write_workdir(folder, config: Config, *, metrics=None, state=None):
    """The folder of a run: finished with metrics, with a checkpoint of a state."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "config.json").write_text(to_json(config))
    if metrics is not None:
        (folder / "report").mkdir()
        (folder / "report" / "metrics.json").write_text(json.dumps(metrics))
    if state is not None:
        with contextlib.closing(Checkpoints(folder / "checkpoints")) as checkpoints:
            checkpoints.save(state, seconds=9.0)
    return folder


def run_python(*words: str, **environment: str | None):
    """The ended process of Python in this folder; None takes a variable away."""
    both = os.environ | {"JAX_PLATFORMS": "cpu"} | environment
    return subprocess.run(
        [sys.executable, *words],
        capture_output=True,
        text=True,
        cwd=Path(__file__).parent,
        timeout=300,
        env={name: value for name, value in both.items() if value is not None},
    )


def find_address() -> str:
    """An address of this machine whose port is free."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return f"127.0.0.1:{found.getsockname()[1]}"


def copy(tree):
    """A copy whose memory a training step may take."""
    return jax.tree.map(jnp.copy, tree)


def random_quaternions(seed: int, *shape: int) -> np.ndarray:
    """Unit quaternions [*shape, 4] in float64."""
    q = np.random.default_rng(seed).normal(size=(*shape, 4))
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def draw_mask(points, quaternion, *, size: int = IMAGE_SIZE, radius=1.0) -> np.ndarray:
    """Bytes [size, size]: 255 within `radius` pixels of a projected point."""
    rows, columns, _ = project_points(points, quaternion, size)
    i, j = np.mgrid[:size, :size] + 0.5
    square = (i[..., None] - rows) ** 2 + (j[..., None] - columns) ** 2
    return np.where(square.min(-1) <= radius**2, 255, 0).astype(np.uint8)


def make_dataset(*, models: int = 3, views: int = 3, seed: int = 0) -> DataSet:
    """Boxes of random points, seen from random sides, without any ray casting."""
    rng = np.random.default_rng(seed)
    poses = random_quaternions(seed, models, views)
    sides = np.sort(rng.uniform(0.1, 0.6, (models, 3)))
    surfaces = rng.uniform(-0.5, 0.5, (models, 60, 3)) * sides[:, None]
    masks = np.array(
        [
            [draw_mask(s, q) for q in views_of]
            for s, views_of in zip(surfaces, poses, strict=True)
        ]
    )
    shade = rng.integers(0, 200, (models, views, 1, 1, 3))
    images = np.where(masks[..., None] > 0, shade, 255).astype(np.uint8)
    return DataSet(
        images=images,
        masks=masks,
        depths=np.zeros(masks.shape, np.float32),
        quaternions=poses.astype(np.float32),
        surfaces=surfaces.astype(np.float32),
        names=tuple(f"box-{i}" for i in range(models)),
        skipped=(),
    )


def make_batch(*, models: int = 2, views: int = 2, seed: int = 0) -> dict:
    """A batch as `read_batch` gives it."""
    dataset = make_dataset(models=models, views=views, seed=seed)
    return {
        "images": dataset.images,
        "masks": dataset.masks,
        "quaternions": dataset.quaternions,
        "seeds": np.zeros(models, np.uint32),
        "view_ids": np.arange(models * views, dtype=np.int32).reshape(models, views),
    }


def assert_same_bits(first, second):
    """Fail unless two trees have the same leaves, bit for bit."""
    assert jax.tree.structure(first) == jax.tree.structure(second)
    for a, b in zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True):
        np.testing.assert_array_equal(np.asarray(a), np.asarray(b), strict=True)
