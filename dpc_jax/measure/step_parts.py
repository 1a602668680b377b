"""The parts of a training step, each compiled alone, on a batch of random images."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from dpc_jax.config import Config
from dpc_jax.learning import devices, half_turns, objective, schedules
from dpc_jax.learning.cameras import Cameras
from dpc_jax.learning.choice import batch_choice, common_frame
from dpc_jax.learning.choice.winners import compare_winners
from dpc_jax.learning.losses import downsample_images
from dpc_jax.learning.predictions import (
    draw_order,
    encode_views,
    predict_poses,
    predict_shapes,
)
from dpc_jax.learning.silhouette_pull import pull_batch
from dpc_jax.learning.step import (
    init_state,
    make_optimizer,
    make_train_step,
    repeat_seed,
)
from dpc_jax.learning.terms import sum_terms
from dpc_jax.render import Camera
from dpc_jax.run.setup import make_network


def draw_batch(config: Config, *, seed: int = 0) -> dict[str, np.ndarray]:
    """A batch of random images and poses; each mask is a disc."""
    rng = np.random.default_rng(seed)
    shape = config.train.models_per_batch, config.train.views_per_batch
    size = config.data.image_size
    place = np.linalg.norm(np.indices((size, size)) - (size - 1) / 2, axis=0)
    poses = rng.normal(size=(*shape, 4)).astype(np.float32)
    return {
        "images": rng.integers(0, 256, (*shape, size, size, 3), np.uint8),
        "masks": np.broadcast_to(
            np.where(place < size / 3, 255, 0).astype(np.uint8), (*shape, size, size)
        ),
        "quaternions": poses / np.linalg.norm(poses, axis=-1, keepdims=True),
        "seeds": repeat_seed(seed, shape[0]),
    }


def make_calls(config: Config, step: int) -> dict[str, Callable[[], Any]]:
    """The parts of the step with this number, each a call without arguments."""
    network, batch = make_network(config), draw_batch(config)
    state = init_state(network, config)._replace(step=jnp.asarray(step, jnp.int32))
    stage = schedules.find_stage(step, config.render, steps=config.train.steps)
    sigma = schedules.compute_sigma(step, config.render, steps=config.train.steps)
    camera = Camera(config.render.focal_length, config.render.distance)
    params, key = state.params, jax.random.key(0)
    batch = {name: jnp.asarray(array) for name, array in batch.items()}

    encode = functools.partial(encode_views, network=network)
    features = jax.jit(encode)(params, batch["images"], batch["masks"])

    def predict(params, features):
        shapes = predict_shapes(
            params,
            features[:, 0],
            jax.random.split(key, len(features)),
            sigma,
            network=network,
            kept_points=stage.kept_points,
            scale_unit=config.render.scale_unit,
            grid=config.render.grid,
        )
        poses = predict_poses(
            params, features, jnp.eye(3), network=network, pose=config.pose
        )
        return shapes, poses

    shapes, poses = jax.jit(predict)(params, features)
    rotations = poses.candidates[:, 0].reshape(*batch["masks"].shape[:2], 4)

    def choose(top, shapes, candidates, masks):
        return batch_choice.choose_poses(
            shapes,
            candidates,
            masks,
            camera=camera,
            render=config.render,
            pose=dataclasses.replace(config.pose, choice_top=top),
        )

    def compare(kept, rotations, shapes):
        total, *_ = compare_winners(
            shapes._replace(kept=kept),
            rotations,
            batch,
            render=config.render,
            train=config.train,
            stage=stage,
        )
        return total

    def add_priors(points, kept):
        both = shapes._replace(points=points, kept=kept)
        terms = objective.compute_priors(both, jnp.asarray(step), train=config.train)
        return sum_terms(terms)

    def draw_in(kept, rotations):
        return pull_batch(
            kept,
            rotations,
            batch["masks"],
            side=config.render.grid,
            camera=camera,
            cameras=Cameras(),
        )

    def turn_back(winners, points):
        def on_device(winners, points):
            return common_frame.turn_back(
                winners,
                points,
                batch["images"],
                batch["masks"],
                jnp.eye(3),
                common_frame.start_frame(config.pose.turns),
                camera=camera,
                cameras=Cameras(),
                heads=config.pose.candidates,
                is_due=jnp.asarray(True),
            )

        # What devices exchange has one to go round.
        alone = jax.tree.map(lambda a: a[None], (winners, points))
        return jax.vmap(on_device, axis_name=devices.AXIS)(*alone)

    def drop(key, points):
        keys = jax.random.split(key, points.shape[0])
        order = jax.vmap(functools.partial(draw_order, count=points.shape[1]))(keys)
        subset = order[:, : stage.kept_points]
        return jnp.take_along_axis(points, subset[..., None], axis=1)

    def turn(kept, candidates):
        covariance = half_turns.average_covariance(jnp.eye(3), kept, jnp.asarray(step))
        turns = half_turns.find_half_turns(covariance, config.pose.turns)
        return jax.vmap(half_turns.turn_candidates, (0, None))(candidates, turns)

    def shrink(masks):
        return [
            downsample_images(masks, side) for side in (config.render.grid, stage.grid)
        ]

    def pull(function, *arguments):
        """The function's value, and the gradient of a sum over it."""
        value, pull_back = jax.vjp(function, *arguments)
        return value, pull_back(jax.tree.map(jnp.ones_like, value))

    def call(function, *arguments):
        return functools.partial(jax.jit(function), *arguments)

    heads = config.pose.candidates
    return {
        "whole step": _repeat(make_train_step(network, config, stage), state, batch),
        "encoder": call(
            lambda p: pull(lambda q: encode(q, batch["images"], batch["masks"]), p),
            params,
        ),
        "other layers": call(lambda p, f: pull(predict, p, f), params, features),
        "optimiser": _repeat(*_make_update(config, params)),
        "point dropout": call(drop, key, shapes.points),
        "half turns": call(turn, shapes.kept, poses.candidates[:, :heads]),
        "ranking of candidates": call(
            functools.partial(choose, 0), shapes, poses.candidates, batch["masks"]
        ),
        "choice": call(
            functools.partial(choose, config.pose.choice_top),
            shapes,
            poses.candidates,
            batch["masks"],
        ),
        "winners": call(
            jax.value_and_grad(compare, (0, 1)), shapes.kept, rotations, shapes
        ),
        "pull": call(jax.value_and_grad(draw_in), shapes.kept, rotations),
        "common frame": call(
            turn_back,
            batch_choice.Winners(rotations, jnp.zeros(rotations.shape[:2], jnp.int32)),
            shapes.points,
        ),
        "priors": call(
            jax.value_and_grad(add_priors, (0, 1)), shapes.points, shapes.kept
        ),
        "targets": call(shrink, batch["masks"]),
    }


def _make_update(config, params):
    optimizer = make_optimizer(config.train)
    grads = jax.tree.map(lambda a: 1e-3 * jnp.ones_like(a), params)

    def update(state, grads):
        params, moments = state
        updates, moments = optimizer.update(grads, moments, params)
        return (optax.apply_updates(params, updates), moments), ()

    copy = jax.tree.map(jnp.copy, params)
    return jax.jit(update, donate_argnums=0), (copy, optimizer.init(copy)), grads


def _repeat(step, state, *arguments):
    """A call that hands its state, whose memory is given away, from time to time."""
    held = [jax.tree.map(jnp.copy, state)]

    def call():
        held[0], result = step(held[0], *arguments)
        return held[0], result

    return call
