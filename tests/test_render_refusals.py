"""What `project`, `Camera` and `VoxelGrid` refuse, each in a sentence."""

import jax
import numpy as np
import pytest

import dpc_jax

GOOD = {"points": np.zeros((5, 3), "f4"), "rotation": np.ones(4, "f4"), "sigma": 1.0}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"points": np.zeros((2, 5, 3), "f4")}, r"points.*\[2, 5, 3\].*vmap"),
        ({"points": np.zeros((5, 2), "f4")}, r"points.*\[N, 3\].*\[5, 2\]"),
        ({"points": np.zeros((5, 3), int)}, "points.*floating.*int"),
        ({"rotation": np.ones(3, "f4")}, r"rotation.*\[4\].*\[3, 3\].*\[3\]"),
        ({"sigma": np.ones(4)}, r"sigma.*\[5\].*\[4\]"),
        ({"sigma": None}, "sigma and covariance are None"),
        ({"covariance": np.ones((5, 3, 3))}, "sigma=None with a covariance"),
        (
            {"covariance": np.ones((5, 3)), "sigma": None},
            r"covariance.*\[5, 3, 3\].*\[5, 3\].*one matrix per point",
        ),
        ({"sigma": np.ones(5), "method": "trilinear"}, "trilinear.*size per point"),
        (
            {
                "covariance": np.ones((5, 3, 3)),
                "sigma": None,
                "method": "trilinear",
            },
            "trilinear.*size per point",
        ),
        ({"ray_rule": "minimum"}, "ray_rule.*termination.*minimum"),
        ({"scale": np.ones(4)}, r"scale.*\[5\].*\[4\]"),
        ({"translation": np.ones(2)}, r"translation.*\[3\].*\[2\]"),
        ({"signals": ("shadow",)}, "signals.*silhouette.*shadow"),
        ({"signals": "depth"}, "signals.*tuple.*depth"),
        ({"signals": ()}, r"signals.*\(\)"),
        ({"signals": ("color",)}, "colors.*None"),
        ({"colors": np.ones((4, 3))}, r"colors.*\[5, C\].*\[4, 3\].*row per point"),
        ({"colors": np.ones((5, 0))}, r"colors.*C >= 1.*\[5, 0\]"),
        (
            {"colors": np.ones((5, 3)), "background_color": np.ones(2)},
            r"background_color.*\[3\].*\[2\]",
        ),
        ({"background_depth": np.ones(3)}, r"background_depth.*\[3\]"),
        ({"method": "splat"}, "method.*trilinear.*splat"),
    ],
)
def test_wrong_arguments_are_refused_in_a_sentence(change, words):
    arguments = GOOD | change
    with pytest.raises(ValueError, match=f"(?s){words}") as error:
        dpc_jax.project(arguments.pop("points"), arguments.pop("rotation"), **arguments)
    assert str(error.value).endswith(".")


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: dpc_jax.Camera(projection="fisheye"), "fisheye"),
        (lambda: dpc_jax.VoxelGrid(0), "positive.*0"),
        (lambda: dpc_jax.VoxelGrid((4, 4)), r"\(4, 4\)"),
        (lambda: dpc_jax.VoxelGrid((4, 4, -1)), r"\(4, 4, -1\)"),
        (lambda: dpc_jax.VoxelGrid((4, 4, 4.0)), r"\(4, 4, 4.0\)"),
        (lambda: dpc_jax.VoxelGrid(64.0), "int.*64.0"),
        (lambda: dpc_jax.VoxelGrid(None), "int.*None"),
        (lambda: dpc_jax.VoxelGrid("64"), "int.*'64'"),
        (lambda: dpc_jax.VoxelGrid(True), "int.*True"),
        (lambda: dpc_jax.VoxelGrid(8, extent=float("nan")), "extent.*nan"),
        (lambda: dpc_jax.VoxelGrid(8, extent=float("inf")), "extent.*inf"),
        (lambda: dpc_jax.VoxelGrid(8, extent="1"), "extent.*'1'"),
        (lambda: dpc_jax.VoxelGrid(8, extent=0.0), "extent.*0.0"),
    ],
)
def test_impossible_cameras_and_grids_are_refused_in_a_sentence(make, words):
    with pytest.raises(ValueError, match=words) as error:
        make()
    assert str(error.value).endswith(".")


def test_a_grid_takes_integers_of_numpy_and_lists():
    assert dpc_jax.VoxelGrid(np.int64(8)) == dpc_jax.VoxelGrid(8)
    assert dpc_jax.VoxelGrid([4, 5, np.int32(6)]) == dpc_jax.VoxelGrid((4, 5, 6))


def test_lists_of_numbers_are_taken_where_arrays_are():
    def render():
        return dpc_jax.project(
            [[0.1, 0.0, 0.0], [0.0, 0.1, 0.2]],
            [1.0, 0.0, 0.0, 0.0],
            sigma=1.0,
            scale=[1.0, 2.0],
            translation=[0.0, 0.1, 0.0],
            colors=[[0.5], [1.0]],
            grid=dpc_jax.VoxelGrid(4),
            signals=["color"],
        )

    assert jax.eval_shape(render).color.shape == (4, 4, 1)


CLOUD, QUATERNION, IMAGE = (
    np.zeros((5, 3), "f4"),
    np.ones(4, "f4"),
    np.zeros((8, 8), "f4"),
)


def choose(**changes):
    arrays = {"points": CLOUD, "candidates": np.ones((2, 4), "f4"), "target": IMAGE}
    arrays = {"mass": 1.0, "sigma": 1.0, "camera": dpc_jax.Camera()} | arrays | changes
    return dpc_jax.choose_candidate(**arrays)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: dpc_jax.project(None, QUATERNION, sigma=1.0), "points.*NoneType"),
        (lambda: dpc_jax.project(CLOUD, None, sigma=1.0), "rotation.*NoneType"),
        (
            lambda: dpc_jax.project(CLOUD, QUATERNION, sigma=1.0, scale=None),
            "scale.*None",
        ),
        (lambda: dpc_jax.project(CLOUD, QUATERNION, sigma=1j), "sigma.*real.*complex"),
        (
            lambda: dpc_jax.project(CLOUD, QUATERNION, sigma=1.0, signals=3),
            "signals.*3",
        ),
        (
            lambda: dpc_jax.project(CLOUD, QUATERNION, sigma=1.0, camera=None),
            "Camera.*NoneType",
        ),
        (
            lambda: dpc_jax.project(
                CLOUD, QUATERNION, sigma=1.0, camera=dpc_jax.Camera(np.ones(5))
            ),
            r"focal_length.*\[5\].*vmap",
        ),
        (
            lambda: dpc_jax.project(CLOUD, QUATERNION, sigma=1.0, grid=32),
            "VoxelGrid.*int",
        ),
        (
            lambda: dpc_jax.project(
                CLOUD, QUATERNION, sigma=1.0, background_depth=None
            ),
            "background_depth.*NoneType",
        ),
        (lambda: dpc_jax.splat(CLOUD, np.zeros(4, "f4"), (4, 4, 4)), r"\[5\].*\[4\]"),
        (lambda: dpc_jax.splat(CLOUD, np.zeros(5, int), (4, 4, 4)), "values.*int"),
        (lambda: dpc_jax.splat(CLOUD, np.zeros(5, "f4"), (4, 4)), r"\(4, 4\)"),
        (lambda: dpc_jax.splat(CLOUD, np.zeros(5, "f4"), (4, 4, -1)), "-1"),
        (lambda: dpc_jax.smooth(IMAGE, 1.0), r"volume.*\[N, N, N\].*\[8, 8\]"),
        (lambda: dpc_jax.smooth(np.zeros((2, 2, 2), int), 1.0), "volume.*int"),
        (lambda: dpc_jax.smooth(np.zeros((2, 0, 2), "f4"), 1.0), r"positive.*0"),
        (
            lambda: dpc_jax.smooth(np.zeros((2, 2, 2), "f4"), np.ones(2)),
            r"sigma.*\[2\]",
        ),
        (lambda: dpc_jax.smooth(np.zeros((2, 2, 2), "f4"), -1.0), "sigma.*-1.0"),
        (lambda: dpc_jax.opacity(np.float32(1)), r"\[..., N\].*\[\]"),
        (lambda: dpc_jax.opacity(np.zeros((3, 0), "f4")), r"one cell.*\[3, 0\]"),
        (lambda: dpc_jax.termination_probabilities([1, 0]), "occupancy.*int"),
        (
            lambda: dpc_jax.quaternion.normalize(np.ones((2, 4))),
            r"\[4\].*\[2, 4\].*vmap",
        ),
        (lambda: dpc_jax.quaternion.to_matrix([1, 0, 0, 0]), "quaternion.*int"),
        (lambda: dpc_jax.quaternion.multiply(QUATERNION, CLOUD), r"right.*\[5, 3\]"),
        (lambda: dpc_jax.quaternion.rotate(CLOUD, np.ones(3)), r"\[4\] or \[3, 3\]"),
        (lambda: dpc_jax.quaternion.from_matrix(np.eye(2)), r"matrix.*\[2, 2\]"),
        (lambda: dpc_jax.quaternion.normalize("up"), "quaternion.*str"),
        (
            lambda: dpc_jax.reprojection_loss(IMAGE.astype("u1"), IMAGE),
            "predicted.*uint8",
        ),
        (lambda: choose(candidates=np.ones((0, 4), "f4")), "one candidate.*0 cand"),
        (lambda: choose(target=np.zeros((8, 4), "f4")), r"square.*\[8, 4\]"),
        (lambda: choose(choice_points=-1), "choice_points.*-1"),
        (lambda: choose(choice_top=1.5), "choice_top.*1.5"),
        (lambda: choose(renders_at_once=True), "renders_at_once.*True"),
    ],
)
def test_every_public_function_refuses_what_it_can_see_is_wrong(call, words):
    with pytest.raises(ValueError, match=f"(?s){words}") as error:
        call()
    assert str(error.value).endswith(".")
