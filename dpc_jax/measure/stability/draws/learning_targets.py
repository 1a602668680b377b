"""Random draws for losses, the choice among candidates, networks and metrics."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from dpc_jax import evaluation
from dpc_jax.learning import hindsight, losses
from dpc_jax.measure.stability.draws.targets import LARGEST, Range, Target
from dpc_jax.networks import ShapePoseNetwork
from dpc_jax.render import Camera

_SLACK = 4 * float(np.finfo(np.float32).eps)
_QUATERNION = Range((4,), smallest=1e-30, usual=(-1, 1))


def list_targets() -> list[Target]:
    """Targets of `dpc_jax.learning`, `dpc_jax.networks` and `dpc_jax.evaluation`."""
    return [
        *_list_losses(),
        *_list_choices(),
        *_list_networks(),
        *_list_metrics(),
    ]


def _list_losses():
    image, points = Range((4, 5), -1e18, 1e18, (0, 1)), Range((5, 3), -1e18, 1e18)
    squared = "coordinates ≤ 1e18: distances are squared"
    yield Target(
        "reprojection_loss",
        losses.reprojection_loss,
        (image, image),
        _is_not_negative,
        "values ≤ 1e18: the loss is their square",
    )
    yield Target(
        "student_loss",
        losses.student_loss,
        (_QUATERNION, _QUATERNION),
        lambda loss, *_: {"in [0, 1]": (loss >= -_SLACK) & (loss <= 1)},
        "components 0 or ≥ 1e-30 (the gradient grows as 1/|q|)",
    )
    yield Target(
        "losses.selection_loss",
        lambda logits: losses.selection_loss(logits, jnp.array([0, 2])),
        (Range((2, 3), -1e37, 1e37, (-3, 3)),),
        lambda loss, *_: {"not negative": loss >= -_SLACK},
        "logits ≤ 1e37: the loss is their difference",
    )
    energy, outside = losses.repulsion_energy, losses.containment_loss
    yield Target("losses.repulsion_energy", energy, (points,), limit=squared)
    yield Target(
        "losses.containment_loss", outside, (points,), _is_not_negative, squared
    )


def _is_not_negative(loss, *_):
    return {"not negative": loss >= 0}


def _list_choices():
    yield Target(
        "losses.downsample_images",
        lambda images: losses.downsample_images(images, 4),
        (Range((2, 8, 8), 0, 255, (0, 255), kind="byte"),),
        lambda images, *_: {"in [0, 1]": jnp.all((images >= 0) & (images <= 1))},
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
        lambda index, *_: {"a candidate": (index >= 0) & (index < 3)},
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
        holds=lambda outputs, *_: {
            "points in the unit cube": jnp.all(jnp.abs(outputs["points"]) <= 0.5)
        },
        limit="images in [-1, 1], its domain",
    )


def _list_metrics():
    poses, cloud = Range((2, 2, 4), usual=(-1, 1)), Range((2, 5, 3))
    plain = {"is_traced": False, "has_gradient": False, "refusals": (ValueError,)}
    yield Target(
        "rotation_angle_deg",
        evaluation.rotation_angle_deg,
        (poses, poses),
        lambda angle, *_: {"in [0, 180]": np.all((angle >= 0) & (angle <= 180))},
        "a zero quaternion is refused",
        **plain,
    )
    yield Target(
        "pose_summary",
        evaluation.pose_summary,
        (Range((7,), usual=(0, 180)),),
        lambda found, *_: {"a share": 0 <= found.accuracy <= 1},
        "errors outside 0 to 180 degrees are refused",
        **plain,
    )
    yield Target(
        "chamfer_distance",
        evaluation.chamfer_distance,
        (Range((6, 3)), Range((5, 3))),
        lambda found, *_: {"not negative": min(found) >= 0},
        **plain,
    )
    yield Target(
        "align",
        _align,
        (poses, poses, cloud, cloud),
        lambda found, *_: {
            "unit rotation": abs(np.linalg.norm(found[0]) - 1) <= 1e-12,
            "spread and rms are numbers": not np.any(found[-1]),
        },
        "a zero quaternion is refused; spread and rms are infinite if nothing is near",
        **plain,
    )


def _align(*arrays):
    """The fields of an alignment that must be finite; then, of the others, any NaN."""
    found = evaluation.align(*arrays)
    may_be_infinite = [found.spread_deg, found.rms]
    return (
        found.rotation,
        found.inlier_share,
        found.chamfer,
        found.icp_turn_deg,
        np.isnan(may_be_infinite),
    )
