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

_EPSILON = float(np.finfo(np.float32).eps)
_QUATERNION = Range((4,), smallest=1e-30, usual=(-1, 1))
_SIDE = 8


def list_targets() -> list[Target]:
    """Targets of `dpc_jax.learning`, `dpc_jax.networks` and `dpc_jax.evaluation`."""
    return [*_list_losses(), *_list_networks(), *_list_metrics()]


def _list_losses():
    image = Range((4, 5), -1e18, 1e18, (0, 1))
    yield Target(
        name="reprojection_loss",
        function=losses.reprojection_loss,
        inputs=(image, image),
        holds=lambda loss, *_: {"not negative": loss >= 0},
        limit="values ≤ 1e18: the loss is their square",
    )
    yield Target(
        name="student_loss",
        function=losses.student_loss,
        inputs=(_QUATERNION, _QUATERNION),
        holds=lambda loss, *_: {"in [0, 1]": (loss >= -4 * _EPSILON) & (loss <= 1)},
        limit="components 0 or ≥ 1e-30 (the gradient is of the size of 1/|q|)",
    )
    yield Target(
        name="losses.selection_loss",
        function=lambda logits: losses.selection_loss(logits, jnp.array([0, 2])),
        inputs=(Range((2, 3), -1e37, 1e37, (-3, 3)),),
        holds=lambda loss, *_: {"not negative": loss >= -4 * _EPSILON},
        limit="logits ≤ 1e37: the loss is their difference",
    )
    yield Target(
        name="losses.repulsion_energy",
        function=losses.repulsion_energy,
        inputs=(Range((5, 3), -1e18, 1e18),),
        limit="coordinates ≤ 1e18: distances are squared",
    )
    yield Target(
        name="losses.containment_loss",
        function=losses.containment_loss,
        inputs=(Range((5, 3), -1e18, 1e18),),
        holds=lambda loss, *_: {"not negative": loss >= 0},
        limit="coordinates ≤ 1e18: distances are squared",
    )
    yield Target(
        name="losses.downsample_images",
        function=lambda images: losses.downsample_images(images, 4),
        inputs=(Range((2, 8, 8), 0, 255, (0, 255), kind="byte"),),
        holds=lambda images, *_: {"in [0, 1]": jnp.all((images >= 0) & (images <= 1))},
        has_gradient=False,
    )
    yield Target(
        name="choose_candidate",
        function=lambda points, mass, candidates, target, sigma: (
            hindsight.choose_candidate(
                points, mass, candidates, target, sigma=sigma, camera=Camera()
            )
        ),
        inputs=(
            Range((5, 3)),
            Range((), 0, LARGEST, (0, 2)),
            Range((3, 4), usual=(-1, 1)),
            Range((_SIDE, _SIDE), 0, 1, (0, 1)),
            Range((), 0, LARGEST, (0, 3)),
        ),
        holds=lambda index, *_: {"a candidate": (index >= 0) & (index < 3)},
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


def _list_networks():
    def predict(images):
        network, params = _make_network()
        return network.apply(params, images)

    def check(outputs, *_):
        return {"points in the unit cube": jnp.all(jnp.abs(outputs["points"]) <= 0.5)}

    yield Target(
        name="ShapePoseNetwork",
        function=predict,
        inputs=(Range((1, 16, 16, 3), -1, 1, (-1, 1)),),
        holds=check,
        limit="images in [-1, 1], its domain",
    )


def _list_metrics():
    poses = Range((2, 2, 4), usual=(-1, 1))
    cloud = Range((2, 5, 3))
    degrees = {"is_traced": False, "has_gradient": False, "refusals": (ValueError,)}
    yield Target(
        name="rotation_angle_deg",
        function=evaluation.rotation_angle_deg,
        inputs=(poses, poses),
        holds=lambda angle, *_: {"in [0, 180]": np.all((angle >= 0) & (angle <= 180))},
        limit="a zero quaternion is refused",
        **degrees,
    )
    yield Target(
        name="pose_summary",
        function=evaluation.pose_summary,
        inputs=(Range((7,), usual=(0, 180)),),
        holds=lambda found, *_: {"a share": 0 <= found.accuracy <= 1},
        limit="errors outside 0 to 180 degrees are refused",
        **degrees,
    )
    yield Target(
        name="chamfer_distance",
        function=evaluation.chamfer_distance,
        inputs=(Range((6, 3)), Range((5, 3))),
        holds=lambda found, *_: {"not negative": min(found) >= 0},
        **degrees,
    )
    yield Target(
        name="align",
        function=_align,
        inputs=(poses, poses, cloud, cloud),
        holds=lambda found, *_: {
            "unit rotation": abs(np.linalg.norm(found[0]) - 1) <= 1e-12,
            "spread and rms are numbers": not np.any(found[-1]),
        },
        limit="a zero quaternion is refused; spread and rms are infinite where nothing "
        "is near",
        **degrees,
    )


def _align(*arrays):
    """The alignment's finite fields, then whether each that may be infinite is NaN."""
    found = evaluation.align(*arrays)
    may_be_infinite = [found.spread_deg, found.rms]
    return (
        found.rotation,
        found.inlier_share,
        found.chamfer,
        found.icp_turn_deg,
        np.isnan(may_be_infinite),
    )
