"""Point clouds: the shapes of the paper, with the size and the mass of their points.

A scene has points [N, 3], their mass and sigma, and where they are compared colors
[N, 3]. The rank of an array of sizes says what they are: () is a sigma that all points
share, [N] a sigma of each point, and [N, 3, 3] a covariance of each. A batch has one
axis more, but for the shared one.
"""

import dataclasses
import functools
from collections.abc import Mapping

import chex
import jax
import jax.numpy as jnp

from dpc_jax.learning import losses
from dpc_jax.learning.cameras import place_camera
from dpc_jax.learning.choice import coarse_choice
from dpc_jax.learning.losses import Term
from dpc_jax.learning.schedules import PULL_FROM
from dpc_jax.learning.shapes.kind import Shape
from dpc_jax.learning.signals import downsample_images
from dpc_jax.render import mass_of_peak, project, quaternion
from dpc_jax.render.kernels import sample_gaussian

REPELLED = 160  # points that repel each other in a step, for the time that pairs take


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Points(Shape):
    """Predicted clouds of B images.

    Attributes:
      points: [B, N, 3], all predicted points.
      kept: [B, n, 3], those that point dropout keeps.
      colors: [B, n, 3] of the kept points, or None.
      scale: [B] in (0, 1), the learned scaling coefficient.
      mass: [B] of each point, voxels; [B, n] where sizes are learned.
      sigma: () of each point, voxels; where sizes are learned, [B, n] of each kept
        point, or the covariances [B, n, 3, 3] in voxels².
    """

    points: jax.Array
    kept: jax.Array
    colors: jax.Array | None
    scale: jax.Array
    mass: jax.Array
    sigma: jax.Array

    @classmethod
    def read(cls, output, sigma, *, render):
        """All points that a network predicts; learned sizes take sigma's place."""
        points, scale = output["points"], output["scale"]
        if "sizes" in output:
            size, mass = measure_points(output, grid=render.grid)
        else:
            size = sigma
            mass = compute_mass(scale, sigma, scale_unit=render.scale_unit)
        return cls(points, points, output.get("colors"), scale, mass, size)

    def drop(self, keys, kept_points):
        """The clouds with some of their points, drawn with each one's key of [B].

        One subset of points serves all candidates of a view, so that the choice among
        them does not depend on which points were drawn.
        """
        draw = functools.partial(draw_order, count=self.points.shape[1])
        subset = jax.vmap(draw)(keys)[:, :kept_points]
        kept, colors = jax.tree.map(
            lambda a: jnp.take_along_axis(a, subset[..., None], axis=1),
            (self.points, self.colors),
        )
        size, mass = self.sigma, self.mass
        if size.ndim:
            take = jax.vmap(lambda array, rows: array[rows])
            size, mass = take(size, subset), take(mass, subset)
        return dataclasses.replace(
            self, kept=kept, colors=colors, mass=mass, sigma=size
        )

    def list_scenes(self, ratio=1.0):
        colors = {} if self.colors is None else {"colors": self.colors}
        sigma, mass = scale_sizes(self.sigma, self.mass, ratio)
        scene = {"points": self.kept, "mass": mass} | colors
        if sigma.ndim:
            return scene | {"sigma": sigma}, {}
        return scene, {"sigma": sigma}

    def find_places(self):
        return self.kept, None

    def find_scale(self):
        return self.scale

    def find_cloud(self):
        return self.points

    def find_priors(self, step, *, train):
        """Containment; repulsion, which comes in from the half on, of formed shapes."""
        terms = {}
        if train.containment_weight:
            outside = jnp.mean(jax.vmap(losses.containment_loss)(self.points))
            terms["containment"] = Term(outside, train.containment_weight)
        if train.repulsion_weight:
            ramp = jnp.maximum(0, 2 * (step / train.steps) - 1)
            energy = jax.lax.cond(
                ramp > 0,
                lambda points: jnp.mean(jax.vmap(losses.repulsion_energy)(points)),
                lambda _: jnp.zeros(()),
                self.kept[:, :REPELLED],
            )
            # A mean, as the reprojection of all points is: the balance of the two is
            # the same however many points there are.
            terms["repulsion"] = Term(energy, train.repulsion_weight * ramp)
        return terms

    def find_pulls(self, views, batch, step, *, recipe):
        """The pull into silhouettes, once these are seen from the right poses.

        Its mean over all views has a gradient to the points alone.
        """
        if not recipe.train.pull_weight:
            return {}
        masks, side = batch["masks"], recipe.render.grid

        def measure(points, view, silhouette):
            return losses.pull_inside(
                points,
                view["rotation"],
                losses.measure_outside(silhouette),
                camera=place_camera(recipe.camera, view),
                translation=view.get("translation"),
            )

        def pull(points, views):
            silhouettes = downsample_images(masks, side)
            still = jax.lax.stop_gradient(views)
            return jnp.mean(jax.vmap(measure)(points, still, silhouettes))

        value = jax.lax.cond(
            step >= PULL_FROM * recipe.train.steps,
            pull,
            lambda points, views: jnp.zeros(()),
            self.kept,
            views,
        )
        return {"pull": Term(value, recipe.train.pull_weight * side**2)}

    @staticmethod
    def find_evaluated(output, scene):
        found = {name: output[name] for name in ("points", "colors") if name in output}
        return found | ({"sizes": scene["sigma"]} if "sigma" in scene else {})

    @staticmethod
    def weigh_finest(scene, render):
        """Points have together the mass that training renders last.

        Their masses were learned where dropout leaves a share of them out: with
        `render.keep_end` below 1, outlines of all of them would be wider than the
        images'.
        """
        mass, ratio = render.keep_end * scene["mass"], render.finest / render.grid
        sigma, mass = scale_sizes(scene["sigma"], mass, ratio)
        return {**scene, "sigma": sigma, "mass": mass}

    @classmethod
    def render(cls, scene, view, *, signals, background_depth=10.0):
        size = jnp.asarray(scene["sigma"])
        is_covariance = size.ndim == 3
        return project(
            scene["points"],
            view.rotation,
            sigma=None if is_covariance else size,
            covariance=size if is_covariance else None,
            scale=scene["mass"],
            colors=scene["colors"] if "color" in signals else None,
            signals=signals,
            background_depth=background_depth,
            max_blocks=None if size.ndim else view.max_blocks,
            method="gaussian" if size.ndim else view.method,
            **view.arguments,
        )

    @classmethod
    def rank(cls, scene, view, target, how):
        """By the optical depths of some points in the image, where all are alike."""
        points, mass, sigma = scene["points"], scene["mass"], scene["sigma"]
        if not how.points or jnp.ndim(mass) or jnp.ndim(sigma):
            return None
        some = points[: how.points]
        mass = mass * (len(points) / len(some))
        return coarse_choice.compute_image_losses(some, mass, view, target, sigma=sigma)


def draw_order(key: jax.Array, *, count: int) -> jax.Array:
    """The indices 0 to count - 1 in random order, [count] int32.

    One sort of single numbers: random bits above, the index below. This is several
    times faster than `jax.random.permutation`, which sorts pairs, twice. Two indices
    whose random bits agree stay in their order: of 2000, about one pair in a draw.
    """
    index_bits = max(1, (count - 1).bit_length())
    bits = jax.random.bits(key, (count,), jnp.uint32) >> index_bits << index_bits
    packed = jnp.sort(bits | jnp.arange(count, dtype=jnp.uint32))
    return (packed & (2**index_bits - 1)).astype(jnp.int32)


def compute_mass(scale: jax.Array, sigma: jax.Array, *, scale_unit: str) -> jax.Array:
    """Mass of a point in voxels from the learned scaling coefficient in (0, 1).

    With the unit "peak" the coefficient is the peak height c_i of Eq. 3, as sampled at
    cell centres: at one, a point on a centre fills its cell, whatever its sigma. With
    "mass" it is the integral of the point's density, as in the released code.

    `mass_of_peak` is the same from a sigma of 0.7 on, to 0.1 %. It has the peak of the
    density, not of its samples: under it points would fade away while the schedule
    makes them thinner than a voxel.
    """
    if scale_unit == "mass":
        return scale
    return scale / sample_gaussian(jnp.zeros(()), sigma) ** 3


def measure_points(
    shape: Mapping[str, jax.Array], *, grid: int
) -> tuple[jax.Array, jax.Array]:
    """(size, mass) of points of learned sizes, of B objects in a grid.

    The learned scale is here the peak height c_i of Eq. 3, whatever
    `render.scale_unit`: between the bounds of a size the masses that show at all span
    six powers of ten. A mass is c·(2π)^{3/2}·√|Σ|, so that a Gaussian that is thinner
    than a voxel fills its share of the cells and no more.

    A covariance is R·diag(s²)·Rᵀ of the widths and the turn of a point. A quaternion of
    any length makes seven numbers for six: overcomplete, as the paper says, but without
    the discontinuities of angles, and positive definite for all values.

    Args:
      shape: of `ShapeHead`. grid: side of the volume, in voxels.

    Returns:
      ([B, N] sigmas in voxels, or [B, N, 3, 3] covariances in voxels²; [B, N] voxels).
    """

    def make_covariance(widths, turn):
        # Entry by entry: as a matrix product of 3 × 3 it took longer on a CPU.
        scaled = quaternion.to_matrix(turn) * widths[None]
        return jnp.sum(scaled[:, None] * scaled[None], axis=-1)

    widths = grid * shape["sizes"]
    product = jnp.prod(jnp.broadcast_to(widths, (*widths.shape[:-1], 3)), axis=-1)
    mass = mass_of_peak(shape["scale"][:, None], jnp.ones(())) * product
    if "turns" not in shape:
        return widths[..., 0], mass
    return jax.vmap(jax.vmap(make_covariance))(widths, shape["turns"]), mass


def scale_sizes(
    size: jax.Array, mass: jax.Array, ratio: chex.Numeric
) -> tuple[jax.Array, jax.Array]:
    """Convert sizes of any rank to a grid with `ratio` times as many cells per side.

    A Gaussian as wide as before spans `ratio` times as many voxels, so sigma grows by
    that. With its mass times ratio³ the density of every cell stays as it was (the
    peak height c_i of Eq. 3), and the optical depth of a ray, the sum of its densities,
    grows by `ratio`: a finer grid renders the same points as more opaque. Times ratio²
    the optical depth would stay. Nothing keeps both, because Eq. 4 multiplies what each
    cell lets through, however deep the cell is. With ratio³ poses are slightly more
    accurate (docs/log.md).
    """
    scaled, mass = jnp.asarray(size * ratio), jnp.asarray(mass * ratio**3)
    is_covariance = scaled.ndim > 2
    return (scaled * ratio if is_covariance else scaled), mass
