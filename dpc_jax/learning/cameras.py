"""What a view's camera has of its own: the object's translation, a focal length.

Not in the paper. The released code predicts both from each view, but uses them with
several pose candidates alone, and its focal lengths begin above the true one.
"""

import dataclasses
from collections.abc import Mapping

import jax
import jax.numpy as jnp

from dpc_jax.config import Pose
from dpc_jax.learning.devices import AXIS
from dpc_jax.learning.losses import Term
from dpc_jax.learning.recipe import Recipe
from dpc_jax.render import Camera

# What views have of their own; what is missing is the config's, for all views:
# "translation" [..., 3] of the object in the camera frame, box diagonals, and
# "focal_length" [...] of an image 1 wide.
Cameras = Mapping[str, jax.Array]


def find_cameras(
    predicted: Mapping[str, jax.Array], given: Mapping[str, jax.Array], *, pose: Pose
) -> dict[str, jax.Array]:
    """The `Cameras` of views: predicted, or with known poses those of the data set."""
    arrays = {**(given if pose.known else {}), **predicted}
    names = {"translation": "translations", "focal_length": "focal_lengths"}
    return {one: arrays[many] for one, many in names.items() if many in arrays}


def anchor_cameras(cameras: Cameras, *, recipe: Recipe) -> dict[str, Term]:
    """How far learned cameras of a batch are from the config's in the mean, as a loss.

    Squared, of translations and of logarithms of focal lengths, over all devices, with
    the weight of a silhouette's squares. Images leave these means free: a larger or
    displaced shape undoes them.
    """
    means = []
    if recipe.pose.translation:
        means.append(jnp.mean(cameras["translation"], axis=0))
    if recipe.pose.focal_length:
        shares = cameras["focal_length"] / recipe.camera.focal_length
        means.append(jnp.mean(jnp.log(shares))[None])
    if not means:
        return {}
    loss = jnp.sum(jax.lax.pmean(jnp.concatenate(means), AXIS) ** 2)
    return {"camera_mean": Term(loss, float(recipe.render.grid**2))}


def place_camera(camera: Camera, per_view: Mapping[str, jax.Array]) -> Camera:
    """The camera of a view, with its own focal length where it has one."""
    if "focal_length" not in per_view:
        return camera
    return dataclasses.replace(camera, focal_length=per_view["focal_length"])
