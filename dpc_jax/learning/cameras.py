"""What a view's camera has of its own: the object's translation, a focal length.

Not in the paper. The released code predicts both from each view, but uses them with
several pose candidates alone, and its focal lengths begin above the true one.
"""

import dataclasses
from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp

from dpc_jax.config import Pose
from dpc_jax.learning.devices import AXIS
from dpc_jax.learning.recipe import Recipe, Term
from dpc_jax.networks import ShapePoseNetwork
from dpc_jax.render import Camera


class Cameras(NamedTuple):
    """Cameras of views; what is None is the config's, for all views.

    Attributes:
      translations: [..., 3] of the object in the camera frame, box diagonals.
      focal_lengths: [...], of an image 1 wide.
    """

    translations: jax.Array | None = None
    focal_lengths: jax.Array | None = None


def find_cameras(
    predicted: Mapping[str, jax.Array], given: Mapping[str, jax.Array], *, pose: Pose
) -> Cameras:
    """The cameras of views: learned, or with known poses those of the data set.

    Args:
      predicted: output of the network. given: arrays of the views, those they have.
    """
    if not pose.known:
        given = {}
    return Cameras(
        predicted.get("translations", given.get("translations")),
        predicted.get("focal_lengths", given.get("focal_lengths")),
    )


def predict_cameras(
    params: Mapping,
    features: jax.Array,
    given: Mapping[str, jax.Array],
    *,
    network: ShapePoseNetwork,
    pose: Pose,
) -> Cameras:
    """The cameras of views from their features [B, V, F]; see `find_cameras`."""
    predicted = {}
    if pose.translation or pose.focal_length:
        flat = features.reshape(-1, features.shape[-1])
        output = network.apply(params, flat, method="predict_camera")
        assert isinstance(output, dict)
        views = features.shape[:2]
        predicted = {n: a.reshape(*views, *a.shape[1:]) for n, a in output.items()}
    return find_cameras(predicted, given, pose=pose)


def compute_gauge(cameras: Cameras, camera: Camera, *, pose: Pose) -> jax.Array:
    """How far learned cameras of a batch are from the config's in the mean; ().

    Squared, of translations and of logarithms of focal lengths, over all devices.
    Images leave these means free: a larger or displaced shape undoes them.
    """
    means = []
    if pose.translation:
        assert cameras.translations is not None
        means.append(jnp.mean(cameras.translations.reshape(-1, 3), axis=0))
    if pose.focal_length:
        assert cameras.focal_lengths is not None
        shares = cameras.focal_lengths / camera.focal_length
        means.append(jnp.mean(jnp.log(shares))[None])
    return jnp.sum(jax.lax.pmean(jnp.concatenate(means), AXIS) ** 2)


def find_gauge(cameras: Cameras, *, recipe: Recipe) -> dict[str, Term]:
    """The loss of `compute_gauge`, which has the weight of a silhouette's squares."""
    if not (recipe.pose.translation or recipe.pose.focal_length):
        return {}
    gauge = compute_gauge(cameras, recipe.camera, pose=recipe.pose)
    return {"gauge": Term(gauge, float(recipe.render.grid**2))}


def list_own(cameras: Cameras, views: int) -> dict[str, jax.Array]:
    """What views have of their own, by name, with one leading axis of all views."""
    found = {"translation": cameras.translations, "focal_length": cameras.focal_lengths}
    present = {name: a for name, a in found.items() if a is not None}
    ends = {"translation": (3,), "focal_length": ()}
    return {name: a.reshape(views, *ends[name]) for name, a in present.items()}


def place_camera(camera: Camera, own: Mapping[str, jax.Array]) -> Camera:
    """The camera of a view, with its own focal length where it has one."""
    if "focal_length" not in own:
        return camera
    return dataclasses.replace(camera, focal_length=own["focal_length"])
