"""Point cloud files, read again by another library; atomic writes."""

import io

import numpy as np
import pytest
import trimesh

from dpc_jax.files import SURFACES, write_bytes, write_text
from dpc_jax.reporting.examples import Example
from dpc_jax.reporting.export import write_files, write_ply, write_surface


def read_glb(path):
    """The mesh as its vertices lie in the file, and the node's rotation matrix."""
    # With a material trimesh drops the colours of the vertices.
    scene = trimesh.load_scene(path, skip_materials=True)
    matrix, name = scene.graph[scene.graph.nodes_geometry[0]]
    return scene.geometry[name], matrix


def write_mesh(path, points):
    return write_surface(path.with_suffix(".glb"), points, [[0, 0, 0]])


def test_a_ply_file_holds_the_same_points_and_colours_if_any(tmp_path):
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.5, 0.5, (40, 3)).astype(np.float32)
    colors = rng.integers(0, 256, (40, 3)) / 255
    path = tmp_path / "a.ply"
    for given in (colors, None):
        read = trimesh.load(write_ply(path, points, given))
        np.testing.assert_array_equal(read.vertices.astype(np.float32), points)
        assert (b"red" in path.read_bytes()) == (given is not None)
        if given is not None:
            np.testing.assert_array_equal(read.colors[:, :3], np.rint(255 * colors))
    # Clipped, not wrapped.
    write_ply(path, np.zeros((1, 3)), np.array([[-0.2, 0.5, 1.3]]))
    assert trimesh.load(path).colors[0, :3].tolist() == [0, 128, 255]


def test_glb_colours_are_linear_light_and_those_of_other_formats_are_not(tmp_path):
    ball = trimesh.creation.icosphere(1)
    colors = np.random.default_rng(0).integers(0, 256, ball.vertices.shape) / 255
    for name in ("a.glb", "a.ply", "a.obj"):
        path = write_surface(tmp_path / name, ball.vertices, ball.faces, colors)
        mesh = read_glb(path)[0] if name == "a.glb" else trimesh.load(path)
        assert mesh.is_watertight and mesh.volume > 0
        found = mesh.visual.vertex_colors[:, :3] / 255
        if name == "a.glb":
            low = found <= 0.0031308
            found = np.where(low, 12.92 * found, 1.055 * found ** (1 / 2.4) - 0.055)
        # A byte of linear light is at most 12.92 / 255 / 2 of sRGB in the dark.
        np.testing.assert_allclose(found, colors, atol=0.026, err_msg=name)
    # glTF has y up and z to the front; a rotation from a float64 quaternion.
    matrix = read_glb(tmp_path / "a.glb")[1]
    turned = matrix[:3, :3] @ np.array([[0, 0, 1], [1, 0, 0]]).T
    np.testing.assert_allclose(turned.T, [[0, 1, 0], [0, 0, 1]], atol=1e-12)


def test_a_cloud_comes_with_splats_and_a_surface_of_its_colours(tmp_path):
    points = np.asarray(trimesh.creation.icosphere(3, radius=0.4).vertices)
    colors = np.where(points[:, :1] > 0, [[1.0, 0, 0]], [[0, 0, 1.0]])
    blank = np.zeros((4, 4))
    example = Example("ball", blank, blank, blank, points, colors, None)
    for surface, ending in SURFACES.items():
        path = write_files(example, tmp_path / "ball", surface=surface)
        assert path == tmp_path / f"ball{ending}"
    mesh = trimesh.load(path)
    assert mesh.is_watertight
    red = mesh.visual.vertex_colors[mesh.vertices[:, 0] > 0.1]
    assert np.all(red[:, :3] == [255, 0, 0])
    read = trimesh.load(tmp_path / "ball.ply")
    values = read.metadata["_ply_raw"]["vertex"]["data"]
    found = np.stack([values[f"f_dc_{i}"] for i in range(3)], -1).reshape(-1, 3)
    np.testing.assert_allclose(0.5 + 0.28209479177387814 * found, colors, atol=1e-6)
    assert np.all(values["rot_0"] == 1) and np.all(values["rot_1"] == 0)
    # Vertices of this ball are 0.055 apart; splats reach half the way.
    sizes = np.exp(np.ravel(values["scale_0"]))
    assert np.all((0.02 < sizes) & (sizes < 0.035))


@pytest.mark.parametrize("write", [write_ply, write_mesh])
def test_clouds_unfit_for_a_file_are_refused_and_leave_none(tmp_path, write):
    path = tmp_path / "a"
    with pytest.raises(ValueError, match="finite coordinates"):
        write(path, [[0.0, np.nan, 0.0]])
    with pytest.raises(ValueError, match=r"its shape is \(3,\)"):
        write(path, np.zeros(3))
    assert list(tmp_path.iterdir()) == []


def test_a_write_that_fails_leaves_the_old_file_and_no_debris(tmp_path, monkeypatch):
    path = write_text(tmp_path / "folder" / "a.txt", "old ü")
    assert path.read_text(encoding="utf-8") == "old ü"

    def half_written(self, data):
        with io.FileIO(self, "w") as file:
            file.write(data[:2])
        raise OSError("disk full")

    monkeypatch.setattr("pathlib.Path.write_bytes", half_written)
    with pytest.raises(OSError, match="disk full"):
        write_bytes(path, b"new content")
    assert path.read_text(encoding="utf-8") == "old ü"
    assert list(path.parent.iterdir()) == [path]
