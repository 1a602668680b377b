"""Codes of views: what the encoder says of an image, before shapes are decoded.

Codes of several views of one object can be averaged, and a code can be changed until
the shape that it stands for fits: shapes stay among those that the network knows.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

from dpc_jax.config import Config
from dpc_jax.learning import devices
from dpc_jax.learning.predictions import (
    complete_poses,
    find_probabilities,
    make_inputs,
)
from dpc_jax.networks import ShapePoseNetwork
from dpc_jax.networks.encoder import TINT

IMAGES_AT_ONCE = 64
COMPONENTS = 64  # directions in which codes differ that are told apart


class Codes(NamedTuple):
    """What the encoder and the pose branches say of n views.

    Attributes:
      codes: [n, F] of shapes. tints: [n, 3] that their colours begin from, or None.
      candidates: [n, C, 4], turned ones included; poses: [n, 4], the student's;
        probabilities: [n, C] that the student gives to candidates. None where poses
        are known.
      cameras: translations [n, 3], focal_lengths [n], by name, those that are learned.
    """

    codes: np.ndarray
    tints: np.ndarray | None
    candidates: np.ndarray | None
    poses: np.ndarray | None
    probabilities: np.ndarray | None
    cameras: dict[str, np.ndarray]


def make_coder(network: ShapePoseNetwork, config: Config) -> Callable:
    """The compiled function (state, (images, masks)) -> dict of `Codes`.

    Images are uint8 [n, S, S, 3], masks [n, S, S].
    """

    def encode(state, views):
        inputs = make_inputs(*views, network=network)
        features = network.apply(state.params, inputs, method="encode")
        assert isinstance(features, jax.Array)
        found: dict[str, Any] = {"codes": features[:, : network.hidden]}
        if network.is_tinted:
            found["tints"] = features[:, -TINT:]
        if not config.pose.known:
            output = network.apply(state.params, features, method="predict_pose")
            assert isinstance(output, dict)
            poses = complete_poses(output, state.covariance, pose=config.pose)
            found |= {"candidates": poses.candidates, "poses": poses.student}
            found["probabilities"] = find_probabilities(poses)
        if config.pose.translation or config.pose.focal_length:
            cameras = network.apply(state.params, features, method="predict_camera")
            found["cameras"] = cameras
        return found

    return make_shared(encode, config, devices.OBJECTS)


def make_shared(function: Callable, config: Config, *parts: Any) -> Callable:
    """Compile a function of a state and arrays of n objects, shared by the devices.

    Every device has the whole network: there are few objects.

    Args:
      parts: of the arguments after the state, `devices.OBJECTS` or `devices.WHOLE`.
    """
    in_specs = (devices.WHOLE, *parts)
    return jax.jit(devices.share_padded(function, devices.make_mesh(config), in_specs))


def encode_all(
    coder: Callable, state: NamedTuple, images: np.ndarray, masks: np.ndarray
) -> Codes:
    """`Codes` of images uint8 [n, S, S, 3] with masks [n, S, S].

    Batch by batch; the last one is padded.
    """
    parts = []
    for start in range(0, len(images), IMAGES_AT_ONCE):
        rows = np.arange(start, start + IMAGES_AT_ONCE)
        rows = np.minimum(rows, len(images) - 1)
        batch = np.asarray(images[rows]), np.asarray(masks[rows])
        parts.append(jax.device_get(coder(state, batch)))
    count = len(images)
    found = jax.tree.map(lambda *arrays: np.concatenate(arrays)[:count], *parts)
    return Codes(
        codes=found["codes"],
        tints=found.get("tints"),
        candidates=found.get("candidates"),
        poses=found.get("poses"),
        probabilities=found.get("probabilities"),
        cameras=found.get("cameras", {}),
    )


def find_directions(codes: np.ndarray) -> np.ndarray:
    """Directions [k, F] in which codes [n, F] vary, as long as their deviations.

    The principal axes, `COMPONENTS` at most: a sum of them with normal weights is as
    far from the mean as codes usually are.

    Raises:
      ValueError: for fewer than two codes, which do not vary.
    """
    if len(codes) < 2:
        raise ValueError(
            f"Expected at least two views to measure how codes vary, but got "
            f"{len(codes)}; use a run with more validation images."
        )
    away = np.asarray(codes, np.float64) - np.mean(codes, axis=0)
    _, sizes, axes = np.linalg.svd(away, full_matrices=False)
    deviations = sizes / np.sqrt(len(codes) - 1)
    return (deviations[:, None] * axes)[:COMPONENTS].astype(np.float32)
