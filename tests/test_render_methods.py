"""Every method against the written equations, and what each approximates."""

import functools

import densities
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dpc_jax
from dpc_jax.render.exact import covariances

ALL = ("silhouette", "depth", "color")
SHAPE, EXTENT = (9, 12, 7), 1.1
CAMERA = {"focal_length": 1.7, "distance": 2.1}
COUNT = 12


def make_scene(channels=2):
    rng = np.random.default_rng(0)
    half = rng.normal(size=(COUNT, 3, 3))
    return {
        "points": rng.uniform(-0.3, 0.3, (COUNT, 3)),
        "rotation": rng.normal(size=4),
        "translation": np.array([0.03, -0.05, 0.02]),
        "scale": rng.uniform(0.5, 8.0, COUNT),
        "colors": rng.uniform(size=(COUNT, channels)),
        "sigmas": rng.choice([0.0, 0.1, 0.5, 1.0, 3.0], COUNT),
        # At least 1.2 voxels² in every direction of the grid: aliasing below 1e-9.
        "covariance": half @ half.transpose(0, 2, 1) + 2 * np.eye(3),
    }


@functools.partial(jax.jit, static_argnames=("kind", "method", "signals", "ray_rule"))
def render(
    scene,
    sigma=None,
    covariance=None,
    *,
    kind="perspective",
    method="auto",
    signals=ALL,
    ray_rule="termination",
):
    return dpc_jax.project(
        scene["points"],
        scene["rotation"],
        sigma=sigma,
        covariance=covariance,
        translation=scene["translation"],
        scale=scene["scale"],
        colors=scene["colors"],
        camera=dpc_jax.Camera(*CAMERA.values(), kind),
        grid=dpc_jax.VoxelGrid(SHAPE, extent=EXTENT),
        signals=signals,
        method=method,
        ray_rule=ray_rule,
        background_depth=5.0,
        background_color=0.25,
    )


def to_x64(tree):
    return jax.tree.map(jnp.asarray, tree)


def test_without_perspective_an_isotropic_covariance_is_that_sigma():
    scene = make_scene()
    # The grid's voxels are not cubes: turn nothing, and give each axis its own.
    scene["rotation"] = np.array([1.0, 0, 0, 0])
    sizes = np.array([SHAPE[1], SHAPE[0], SHAPE[2]]) / SHAPE[0]  # of x, y, z
    variances = scene["sigmas"][:, None] ** 2 / sizes**2
    matrices = np.eye(3) * variances[:, None, :]
    options = {"kind": "orthographic", "method": "gaussian"}
    with jax.enable_x64(True):
        scene = to_x64(scene)
        image = render(scene, covariance=to_x64(matrices), **options)
        expected = render(scene, scene["sigmas"], **options)
    for name in ALL:  # rounding
        np.testing.assert_allclose(image[name], expected[name], rtol=0, atol=1e-12)


def test_auto_is_the_fast_method_for_one_sigma_and_the_basic_one_for_several():
    scene = jax.tree.map(lambda a: jnp.asarray(a, "f4"), make_scene())
    covariance, sigmas = scene.pop("covariance"), scene.pop("sigmas")

    def write(method, **size):
        return render.lower(
            scene, **size, method=method, signals=("silhouette",)
        ).as_text()

    one, several = {"sigma": jnp.float32(1)}, {"sigma": sigmas}
    matrices = {"covariance": covariance}
    assert write("auto", **one) == write("trilinear", **one)
    assert write("auto", **one) != write("gaussian", **one)
    assert write("auto", **several) == write("gaussian", **several)
    assert write("auto", **matrices) == write("gaussian", **matrices)


@functools.partial(jax.jit, static_argnames="method")
def render_cloud(points, sigma, method):
    return dpc_jax.project(
        points,
        jnp.array([0.9, 0.1, 0.3, -0.2]),
        sigma=sigma,
        scale=0.5,
        grid=dpc_jax.VoxelGrid(20),
        method=method,
    ).silhouette


@pytest.mark.parametrize("sigma", [1.0, 3.0])
def test_compensated_widening_brings_the_fast_method_to_the_basic_one(sigma):
    with jax.enable_x64(True):
        points = jnp.asarray(np.random.default_rng(5).normal(size=(500, 3)) * 0.1)
        sizes = jnp.asarray(sigma), dpc_jax.compensate_widening(sigma)
        exact = np.asarray(render_cloud(points, sizes[0], "gaussian"))
        plain, compensated = (
            np.asarray(render_cloud(points, size, "trilinear")) for size in sizes
        )
    # Measured: 6 times at 1 voxel, 16 at 2, 23 at 3 (docs/projection.md).
    assert 4 * np.linalg.norm(compensated - exact) < np.linalg.norm(plain - exact)


def test_compensated_sigmas_grow_without_jumps_or_infinite_slopes():
    with jax.enable_x64(True):
        sigma = jnp.concatenate([jnp.array([0.0, 1e-300]), jnp.linspace(0.4, 3, 261)])
        differentiate = jax.jit(
            jax.vmap(jax.value_and_grad(dpc_jax.compensate_widening))
        )
        found, slope = differentiate(sigma)
        large = float(dpc_jax.compensate_widening(1e300))
        sigma, found, slope = (np.asarray(a) for a in (sigma, found, slope))
    assert np.all(np.diff(found) > 0) and np.max(np.diff(found[2:])) < 0.02
    assert np.all((slope > 0) & (slope < 2))
    is_whole = sigma >= 1
    np.testing.assert_allclose(found[is_whole] ** 2, sigma[is_whole] ** 2 - 1 / 6)
    np.testing.assert_array_equal(found[sigma <= 0.5], sigma[sigma <= 0.5])
    assert large == 1e300


def test_sizes_of_zero_among_others_have_no_slope_and_spoil_none():
    scene = make_scene()
    with jax.enable_x64(True):
        scene = to_x64(scene)
        sigmas = scene.pop("sigmas")

        @jax.jit
        @jax.value_and_grad
        def differentiate(sigmas):
            image = render(scene, sigmas, signals=("silhouette",)).silhouette
            return jnp.sum(image * jnp.cos(jnp.arange(image.size)).reshape(image.shape))

        slope = np.asarray(differentiate(sigmas)[1])
        away = np.where(sigmas > 0.2, np.random.default_rng(1).normal(size=COUNT), 0)
        sides = [float(differentiate(sigmas + s * 1e-6 * away)[0]) for s in (1, -1)]
    is_nothing = np.asarray(sigmas) == 0
    assert is_nothing.any() and not is_nothing.all()
    assert np.all(slope[is_nothing] == 0)
    # Differences of a sum of order 10 with rounding 1e-15, over 2e-6.
    assert np.sum(slope * away) == pytest.approx((sides[0] - sides[1]) / 2e-6, abs=1e-7)


# Standard deviation over distance; a round point in the middle, at the corner of the
# image, and one at the corner that is 1 : 1 : 5 long along the axis of view.
FOCAL, DISTANCE = 1.875, 2.0
CASES = (
    (np.eye(3), np.array([0.0, 0.0, DISTANCE])),
    (np.eye(3), np.array([0.5, 0.5, DISTANCE])),
    (np.diag([0.04, 0.04, 1.0]), np.array([0.5, 0.5, DISTANCE])),
)


@jax.jit
def _carry_linear(matrices, centres):
    return covariances.move_covariance(
        matrices,
        centres,
        jnp.eye(3),
        camera=dpc_jax.Camera(FOCAL, DISTANCE),
        grid=dpc_jax.VoxelGrid(16),
    )


def carry_linear(matrix, centre):
    with jax.enable_x64(True):
        return np.asarray(_carry_linear(matrix[None], centre[None])[0])


def measure_linear(ratio, case):
    matrix, centre = CASES[case]
    matrix = matrix * (ratio * DISTANCE) ** 2
    linear = carry_linear(matrix, centre)
    return densities.compare_with_linear(matrix, centre, FOCAL, linear)


@pytest.mark.parametrize("case", range(len(CASES)))
def test_the_error_of_linear_perspective_falls_with_the_size_of_a_point(case):
    rough, fine = measure_linear(0.02, case), measure_linear(0.01, case)
    # First order for where the mass lies and the mean's offset in standard deviations,
    # second for the covariance; the next order is a few per cent of that.
    assert rough[0] / fine[0] == pytest.approx(2, rel=0.02)
    assert rough[2] / fine[2] == pytest.approx(4, rel=0.05)
    assert fine[0] < 0.01 and fine[1] < 0.01 and fine[2] < 3e-4


def test_a_volume_under_perspective_is_as_far_from_exact_as_its_linearisation():
    side, scale = 24, 1e-3
    rng = np.random.default_rng(3)
    half = rng.normal(size=(3, 3)) * 0.6 + np.eye(3)
    matrix = half @ half.T + np.eye(3)  # voxels², 1.0 to 3.1 of them wide
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    point = np.array([0.1, -0.15, 0.05])
    fill = functools.partial(
        dpc_jax.voxelize,
        scale=scale,
        camera=dpc_jax.Camera(FOCAL, DISTANCE),
        grid=dpc_jax.VoxelGrid(side),
    )
    with jax.enable_x64(True):
        volume = jax.jit(fill)(
            jnp.asarray(point[None]), jnp.asarray(turn), covariance=matrix[None]
        )
    centre = turn @ point + np.array([0, 0, DISTANCE])
    turned = turn @ matrix @ turn.T / side**2
    centres = (np.arange(side) + 0.5) / side - 0.5
    places = np.stack(np.meshgrid(centres, centres, centres, indexing="ij"), -1)
    places = places + np.array([0, 0, DISTANCE])
    exact = densities.project_density(places, turned, centre, FOCAL) / side**3
    distance = 0.5 * np.abs(np.asarray(volume) / scale - exact).sum()
    linear = carry_linear(turned, centre)
    expected, _, _ = densities.compare_with_linear(turned, centre, FOCAL, linear)
    assert 0.005 < expected < 0.05
    # Sampled on a coarser lattice, of about one standard deviation.
    assert distance == pytest.approx(expected, rel=0.1)
