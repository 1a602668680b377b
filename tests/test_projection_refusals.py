"""What the public functions of rendering refuse, each in a sentence."""

import functools
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dpc_jax

CLOUD = np.random.default_rng(0).uniform(-0.3, 0.3, (5, 3)).astype("f4")
IDENTITY, MATRIX = np.array([1, 0, 0, 0], "f4"), np.eye(3, dtype="f4")
MATRICES, SINGULAR = np.tile(MATRIX, (5, 1, 1)), np.ones((5, 3, 3), "f4")
CELLS, IMAGE = np.zeros((4, 5, 6), "f4"), np.zeros((8, 8), "f4")
GRID = dpc_jax.VoxelGrid(4)
CLOUDS, POSES = np.tile(CLOUD, (3, 1, 1)), np.tile(IDENTITY, (3, 1))


def give(function, **good):
    """A function of what is wrong, which it refuses before it computes anything."""
    return lambda **changes: function(**good | changes)


project = give(dpc_jax.project, points=CLOUD, rotation=IDENTITY, sigma=1.0, grid=GRID)
anisotropic = functools.partial(project, sigma=None)
project_batch = give(
    *(dpc_jax.project_batch,), points=CLOUDS, rotations=POSES, sigma=1.0, grid=GRID
)
project_volume = give(
    dpc_jax.project_volume, volume=CELLS, rotation=IDENTITY, grid=GRID
)
blocks = functools.partial(project, grid=dpc_jax.VoxelGrid(64), max_blocks=9)
splat = give(
    *(dpc_jax.splat,), coordinates=CLOUD, values=np.zeros(5, "f4"), shape=(4, 4, 4)
)
smooth = give(dpc_jax.smooth, volume=CELLS, sigma=1.0)
rotate = give(dpc_jax.quaternion.rotate, points=CLOUD, rotation=IDENTITY)
camera, grid = give(dpc_jax.Camera), give(dpc_jax.VoxelGrid, shape=8)
fit = give(dpc_jax.fit, silhouettes=np.full((1, 64, 64), 255, "u1"))
choose = give(
    dpc_jax.choose_candidate,
    **{"points": CLOUD, "candidates": np.ones((2, 4), "f4"), "target": IMAGE},
    **{"mass": 1.0, "sigma": 1.0, "camera": dpc_jax.Camera()},
)

SHAPES = [
    (project, {"points": CLOUDS}, r"points.*\[N, 3\].*\[3, 5, 3\].*vmap"),
    (project, {"points": np.zeros((5, 3), int)}, "points.*floating.*int"),
    (project, {"points": None}, "points.*NoneType"),
    (project, {"rotation": np.ones(3, "f4")}, r"rotation.*\[4\].*\[3, 3\].*\[3\]"),
    (project, {"sigma": np.ones(4)}, r"sigma.*\[5\].*\[4\]"),
    (project, {"sigma": 1j}, "sigma.*real.*complex"),
    (project, {"sigma": None}, "sigma and covariance.*none came"),
    (project, {"covariance": MATRICES}, "both came.*sigma=None with a covariance"),
    (
        *(anisotropic, {"covariance": np.ones((5, 3))}),
        r"covariance.*\[5, 3, 3\].*\[5, 3\].*one matrix per point",
    ),
    (project, {"scale": np.ones(4)}, r"scale.*\[5\].*\[4\]"),
    (project, {"translation": np.ones(2)}, r"translation.*\[3\].*\[2\]"),
    (project, {"colors": np.ones((4, 3))}, r"colors.*\[5, C\].*\[4, 3\]"),
    (
        *(project, {"colors": np.ones((5, 3)), "background_color": np.ones(2)}),
        r"background_color.*\[3\].*\[2\]",
    ),
    (project, {"background_depth": np.ones(3)}, r"background_depth.*\[3\]"),
    (project, {"camera": dpc_jax.Camera(np.ones(5))}, r"focal_length.*\[5\].*vmap"),
    (project, {"camera": dpc_jax.Camera(principal_point=0.1)}, r"shape \[2\]"),
    (project, {"grid": 32}, "VoxelGrid.*int"),
    (
        project,
        {"grid": dpc_jax.VoxelGrid(100_000)},
        r"takes 4e\+06 GB; make it coarser",
    ),
    (project, {"ray_rule": "minimum"}, "ray_rule.*termination.*minimum"),
    (project, {"signals": ("shadow",)}, "signals.*silhouette.*shadow"),
    (project, {"signals": "depth"}, "signals.*tuple.*depth"),
    (project, {"signals": ("color",)}, "colors.*None"),
    (camera, {"projection": "fisheye"}, "fisheye"),
    (grid, {"shape": 0}, "positive.*0"),
    (grid, {"shape": (4, 4, 4.0)}, r"\(4, 4, 4.0\)"),
    (grid, {"shape": True}, "int.*True"),
    (grid, {"extent": float("nan")}, "extent.*nan"),
    # Methods.
    (project, {"method": "quartic"}, "method.*trilinear.*quartic"),
    (project, {"sigma": np.ones(5), "method": "trilinear"}, "linear.*size per point"),
    (project, {"sigma": 0.5, "method": "cubic"}, "at least 0.577 voxels"),
    (blocks, {"max_blocks": 0}, "max_blocks must be an integer of at least 1"),
    (blocks, {"method": "gaussian"}, "one sigma for all points"),
    (
        *(blocks, {"max_blocks": 2**31 // 729, "grid": dpc_jax.VoxelGrid(2000)}),
        "fit into",
    ),
    (blocks, {"grid": dpc_jax.VoxelGrid(20_000)}, "fewer than 2³¹ cells"),
    # Batches.
    (project_batch, {"rotations": IDENTITY}, r"rotations .*\[B, 4\] or \[B, 3, 3\]"),
    (project_batch, {"points": CLOUDS[:2]}, r"points .*\[N, 3\] or \[3, N, 3\]"),
    (project_batch, {"sigma": np.ones(5)}, r"\[B, N\] one for each point, or \[1, N\]"),
    (
        project_batch,
        {"translations": np.ones((2, 3))},
        r"translations .*\[3\] or \[3, 3\]",
    ),
    (
        *(project_batch, {"camera": dpc_jax.Camera(np.ones(2))}),
        r"camera.focal_length must have shape \(\) or \[3\]",
    ),
    (project_batch, {"grid": 8}, "grid must be a dpc_jax.VoxelGrid"),
    (project_batch, {"signals": ("color",)}, "must have colors of all"),
    (project_batch, {"renders_at_once": 0}, "renders_at_once.*at least 1.* 0"),
    (project_batch, {"devices": []}, "devices must be at least one, but none came"),
    # Volumes of the object frame.
    (project_volume, {"volume": CELLS[None]}, r"volume.*\[X, Y, Z\].*vmap"),
    (project_volume, {"volume": CELLS[:, :0]}, r"at least one cell.*\[4, 0, 6\]"),
    (project_volume, {"volume": CELLS.astype(int)}, "volume.*floating.*int"),
    (project_volume, {"signals": ("color",)}, "'color' must have colors"),
    (
        *(project_volume, {"colors": np.ones((4, 5, 3), "f4")}),
        r"colors.*\[4, 5, 6, C\].*per cell of a volume",
    ),
    # The steps on their own.
    (splat, {"values": np.zeros(4, "f4")}, r"\[5\].*\[4\]"),
    (splat, {"shape": (4, 4)}, r"\(4, 4\)"),
    (smooth, {"volume": IMAGE}, r"volume.*\[N, N, N\].*\[8, 8\]"),
    (smooth, {"volume": CELLS[:, :0]}, "positive.*0"),
    (smooth, {"sigma": -1.0}, "sigma.*-1.0"),
    (give(dpc_jax.opacity), {"occupancy": np.float32(1)}, r"\[..., N\].*\[\]"),
    (give(dpc_jax.opacity), {"occupancy": IMAGE[:, :0]}, r"one cell.*\[8, 0\]"),
    (rotate, {"rotation": np.ones(3)}, r"\[4\] or \[3, 3\]"),
    (give(dpc_jax.quaternion.from_matrix), {"matrix": np.eye(2)}, r"matrix.*\[2, 2\]"),
    (
        *(give(dpc_jax.reprojection_loss, target=IMAGE), {"predicted": IMAGE > 0}),
        "predicted.*bool",
    ),
    (choose, {"candidates": np.ones((0, 4), "f4")}, "one candidate.*0 cand"),
    (choose, {"target": np.zeros((8, 4), "f4")}, r"square.*\[8, 4\]"),
    (choose, {"choice_points": -1}, "choice_points.*-1"),
    (choose, {"choice_top": 1.5}, "choice_top.*1.5"),
    (choose, {"renders_at_once": True}, "renders_at_once.*True"),
    (give(dpc_jax.use_all_cores), {"count": 1.5}, "count must be an integer.*1.5"),
    (
        give(dpc_jax.to_opencv, rotation=MATRIX),
        {"camera": dpc_jax.Camera(projection="orthographic")},
        "leave the projection out",
    ),
]


@pytest.mark.parametrize("call, wrong, words", SHAPES)
def test_wrong_arguments_are_refused_in_a_sentence(call, wrong, words):
    with pytest.raises(ValueError, match=f"(?s){words}") as error:
        call(**wrong)
    assert str(error.value).endswith(".")


# Numbers that make no image, where they are known.

SIZE = "must be at least 0 voxels and finite"
ZERO = "rotations must be finite and not zero, but one is [0.0, 0.0, 0.0, 0.0]"
FOCAL_LENGTH = "camera.focal_length must be finite and above 0, but"
NUMBERS = [
    (project, "rotation", IDENTITY * np.nan, "rotation must be finite"),
    (project, "rotation", 0 * IDENTITY, "finite and not zero"),
    (project, "rotation", 2 * MATRIX, "and determinant 1, but it is [[2.0"),
    (project, "rotation", -MATRIX, "and determinant 1, but it is [[-1.0"),
    (project, "points", CLOUD * np.inf, "points must be finite"),
    (project, "translation", np.array([0, 0, np.nan]), "translation must be finite"),
    (project, "sigma", -1.0, f"sigma {SIZE}, but it is -1.0"),
    (project, "sigma", np.array([1, 1, -1, 1, 1], "f4"), "one is -1.0"),
    (project, "scale", 1e308, f"scale {SIZE}"),
    (anisotropic, "covariance", MATRICES - SINGULAR, "without negative eigenvalues"),
    (project, "camera", dpc_jax.Camera(-1.0), f"{FOCAL_LENGTH} it is -1.0"),
    (project, "camera", dpc_jax.Camera(1.0, np.inf), "camera.distance must be finite"),
    (project, "camera", dpc_jax.Camera(aspect=0.0), "camera.aspect must be finite"),
    (
        *(project, "camera", dpc_jax.Camera(principal_point=[0.1, np.nan])),
        "camera.principal_point must",
    ),
    (project_batch, "rotations", POSES * [[1], [0], [1]], ZERO),
    (project_batch, "camera", dpc_jax.Camera(-np.ones(3)), f"{FOCAL_LENGTH} one is -1"),
    (fit, "rotations", np.zeros((1, 4), "f4"), "rotations must be finite and not zero"),
]


@pytest.mark.parametrize("call, name, value, says", NUMBERS)
def test_known_numbers_that_make_no_image_are_refused(call, name, value, says):
    for wrong in (value, jax.tree.map(jnp.asarray, value)):
        with pytest.raises(ValueError, match=re.escape(says)):
            call(**{name: wrong})


def test_traced_numbers_are_rendered_by_the_documented_rule():
    """NaN points are left out, a zero quaternion is none, a negative sigma is 0."""

    @jax.jit
    def render(points, rotation, sigma):
        return dpc_jax.project(points, rotation, sigma=sigma, grid=GRID).silhouette

    spoiled = np.concatenate([CLOUD, np.full((1, 3), np.nan, "f4")])
    image = render(spoiled, 0 * IDENTITY, -1.0)
    np.testing.assert_allclose(image, render(CLOUD, IDENTITY, 0.0), atol=1e-6)


def test_lists_integers_and_singular_matrices_are_taken():
    assert dpc_jax.VoxelGrid(np.int64(8)) == dpc_jax.VoxelGrid(8)
    assert dpc_jax.VoxelGrid([4, 5, np.int32(6)]) == dpc_jax.VoxelGrid((4, 5, 6))
    lists = {"points": CLOUD.tolist(), "rotation": [1.0, 0.0, 0.0, 0.0]}
    lists |= {"translation": [0.0, 0.1, 0.0], "scale": [1.0, 2.0, 0.0, 1.0, 1.0]}
    lists |= {"colors": [[0.5]] * 5, "signals": ["color"]}
    image = jax.jit(lambda: anisotropic(covariance=SINGULAR, **lists).color)()
    assert image.shape == (4, 4, 1) and np.isfinite(image).all()
