"""`project_volume`: numbers that are large or not finite."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

import dpc_jax

IDENTITY = jnp.array([1.0, 0.0, 0.0, 0.0])


@functools.partial(jax.jit, static_argnames="side")
def draw(volume, rotation, *, translation=None, side=4):
    return dpc_jax.project_volume(
        volume, rotation, translation=translation, grid=dpc_jax.VoxelGrid(side)
    ).silhouette


def test_occupancies_far_beyond_one_leave_colours_their_gradient():
    """A colour is a mean by occupancy, so its slope falls as they grow: 1e-30 here."""
    rng = np.random.default_rng(4)
    volume = jnp.asarray(rng.uniform(0.5, 1, (3, 3, 3)), jnp.float32)
    colors = jnp.asarray(rng.uniform(size=(3, 3, 3, 1)), jnp.float32)

    @jax.jit
    @jax.grad
    def differentiate(volume):
        image = dpc_jax.project_volume(
            volume,
            IDENTITY,
            colors=colors,
            camera=dpc_jax.Camera(2.5),  # the view lies inside the volume
            grid=dpc_jax.VoxelGrid(4),
            signals=("color",),
        )
        return jnp.sum(image.color)

    # Powers of two, so that the large and the usual case round alike; every sample is
    # above one in both.
    small, large = (differentiate(volume * 2.0**k) for k in (5, 100))
    assert float(jnp.max(jnp.abs(small))) > 0
    np.testing.assert_allclose(large * 2.0**95, small, rtol=1e-4, atol=1e-7)


def test_places_that_are_not_finite_count_as_outside():
    nowhere = jnp.array([jnp.nan, 0, 0])
    assert np.all(draw(jnp.ones((4, 4, 4)), IDENTITY, translation=nowhere) == 0)


def test_a_cell_that_is_not_finite_spoils_the_rays_that_read_it_alone():
    spoiled = np.full((4, 4, 4), 0.3, np.float32)
    spoiled[0, 0, 0] = np.nan
    image = np.asarray(draw(spoiled, IDENTITY))
    # Half of the columns and half of the rows lie nearer to other cells.
    assert np.isnan(image[0, 0]) and np.isfinite(image[2:]).all()
    assert np.isfinite(image[:, 2:]).all()


def test_colours_that_are_not_asked_for_cost_nothing():
    volume, colors = jnp.zeros((5, 7, 6)), jnp.zeros((5, 7, 6, 2))
    call = functools.partial(dpc_jax.project_volume, grid=dpc_jax.VoxelGrid(6))
    with_colors, without = (
        str(jax.make_jaxpr(call)(volume, IDENTITY, colors=c)) for c in (colors, None)
    )
    assert with_colors.count(" gather") == without.count(" gather")
