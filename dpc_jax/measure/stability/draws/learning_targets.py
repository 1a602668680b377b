"""Random draws for losses, the choice among candidates, networks and metrics."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from dpc_jax import evaluation
from dpc_jax.learning import losses
from dpc_jax.learning.choice import hindsight
from dpc_jax.measure.stability.draws.targets import (
    LARGEST,
    Range,
    Target,
    is_share,
    promise,
)
from dpc_jax.networks import ShapePoseNetwork
from dpc_jax.render import Camera

_SLACK = 4 * float(np.finfo(np.float32).eps)
_QUATERNION = Range((4,), smallest=1e-30, usual=(-1, 1))


def list_targets() -> list[Target]:
    """Targets of `dpc_jax.learning`, `dpc_jax.networks` and `dpc_jax.evaluation`."""
    return [*_list_losses(), *_list_choices(), *_list_networks(), *_list_metrics()]


def _list_losses():
    image, points = Range((4, 5), -1e18, 1e18, (0, 1)), Range((5, 3), -1e18, 1e18)
    logits = Range((2, 3), -1e37, 1e37, (-3, 3))
    not_negative = promise("not negative", lambda loss: loss >= 0)
    nearly = promise("not negative", lambda loss: loss >= -_SLACK)
    share = promise("in [0, 1]", lambda loss: (loss >= -_SLACK) & (loss <= 1))
    square = "values ≤ 1e18: the loss is their square"
    apart = "logits ≤ 1e37: the loss is their difference"
    squared = "coordinates ≤ 1e18: distances are squared"
    steep = "components 0 or ≥ 1e-30 (the gradient grows as 1/|q|)"
    reproject, contain = losses.reprojection_loss, losses.containment_loss

    def select(logits):
        return losses.selection_loss(logits, jnp.array([0, 2]))

    for name, function, inputs, limit, *holds in (
        ("reprojection_loss", reproject, (image, image), square, not_negative),
        ("student_loss", losses.student_loss, (_QUATERNION,) * 2, steep, share),
        ("losses.selection_loss", select, (logits,), apart, nearly),
        ("losses.repulsion_energy", losses.repulsion_energy, (points,), squared),
        ("losses.containment_loss", contain, (points,), squared, not_negative),
    ):
        yield Target(name, function, inputs, *holds, limit=limit)


def _list_choices():
    yield Target(
        "losses.downsample_images",
        lambda images: losses.downsample_images(images, 4),
        (Range((2, 8, 8), 0, 255, (0, 255), kind="byte"),),
        promise("in [0, 1]", is_share),
        has_gradient=False,
    )
    yield Target(
        "choose_candidate",
        lambda points, mass, candidates, target, sigma: hindsight.choose_candidate(
            points, mass, candidates, target, sigma=sigma, camera=Camera()
        ),
        (
            Range((5, 3)),
            Range((), 0, LARGEST, (0, 2)),
            Range((3, 4), usual=(-1, 1)),
            Range((8, 8), 0, 1, (0, 1)),
            Range((), 0, LARGEST, (0, 3)),
        ),
        promise("a candidate", lambda index: (index >= 0) & (index < 3)),
        has_gradient=False,
    )


@functools.cache
def _make_network():
    """A small network with its parameters at the start of training."""
    network = ShapePoseNetwork(
        num_points=6, candidates=2, channels=2, hidden=8, shape_hidden=8
    )
    images = jnp.zeros((1, 16, 16, 3))
    return network, jax.jit(network.init)(jax.random.key(0), images)


def _predict(images):
    network, params = _make_network()
    return network.apply(params, images)


def _list_networks():
    yield Target(
        "ShapePoseNetwork",
        _predict,
        (Range((1, 16, 16, 3), -1, 1, (-1, 1)),),
        promise("points in the unit cube", lambda o: jnp.all(abs(o["points"]) <= 0.5)),
        "images in [-1, 1], its domain",
    )


def _list_metrics():
    poses, cloud = Range((2, 2, 4), usual=(-1, 1)), Range((2, 5, 3))
    for name, function, inputs, limit, holds in (
        (
            "rotation_angle_deg",
            *(evaluation.rotation_angle_deg, (poses, poses)),
            "a zero quaternion is refused",
            promise("in [0, 180]", lambda a: np.all((a >= 0) & (a <= 180))),
        ),
        (
            "pose_summary",
            *(evaluation.pose_summary, (Range((7,), usual=(0, 180)),)),
            "errors outside 0 to 180 degrees are refused",
            promise("a share", lambda found: 0 <= found.accuracy <= 1),
        ),
        (
            "chamfer_distance",
            *(evaluation.chamfer_distance, (Range((6, 3)), Range((5, 3)))),
            "",
            promise("not negative", lambda found: min(found) >= 0),
        ),
        (
            "align",
            *(_align, (poses, poses, cloud, cloud)),
            "a zero quaternion is refused; spread and rms are infinite if nothing is "
            "near",
            _is_alignment,
        ),
    ):
        refused = {"is_traced": False, "refusals": (ValueError,)}
        yield Target(name, function, inputs, holds, limit, **refused)


def _is_alignment(found, *_):
    return {
        "unit rotation": abs(np.linalg.norm(found[0]) - 1) <= 1e-12,
        "spread and rms are numbers": not np.any(found[-1]),
    }


def _align(*arrays):
    """The fields of an alignment that must be finite; then, of the others, any NaN."""
    found = evaluation.align(*arrays)
    finite = (found.rotation, found.inlier_share, found.chamfer, found.icp_turn_deg)
    return *finite, np.isnan([found.spread_deg, found.rms])
