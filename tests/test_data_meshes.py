"""Mesh files: found, read with their colours, and refused by name where broken."""

import numpy as np
import pytest
import trimesh
from PIL import Image

from dpc_jax.data import meshes

PLY = """ply
format ascii 1.0
element vertex {}
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
"""


def test_files_are_found_at_any_depth_and_in_order(tmp_path):
    (tmp_path / "b" / "deep").mkdir(parents=True)
    for name in ("z.OBJ", "b/deep/a.stl", "b/c.glb", "notes.txt", "b/colours.mtl"):
        (tmp_path / name).write_bytes(b"")
    (tmp_path / "folder.obj").mkdir()
    found = [p.relative_to(tmp_path).as_posix() for p in meshes.find_meshes(tmp_path)]
    assert found == ["b/c.glb", "b/deep/a.stl", "z.OBJ"]


def test_colours_of_vertices_become_their_mean_on_a_face(tmp_path):
    mesh = trimesh.Trimesh(
        np.eye(3), [[0, 1, 2]], process=False,
        vertex_colors=[[30, 0, 0, 255], [60, 90, 0, 255], [90, 0, 120, 255]],
    )  # fmt: skip
    mesh.export(tmp_path / "v.ply")
    colors = meshes.read_mesh(tmp_path / "v.ply").visual.face_colors
    np.testing.assert_allclose(colors[0, :3], [60, 30, 40], atol=1)  # rounding


def write_textured(folder):
    picture = np.zeros((16, 16, 3), np.uint8)
    picture[:, :8], picture[:, 8:] = (200, 10, 10), (10, 10, 200)
    Image.fromarray(picture).save(folder / "t.png")
    (folder / "t.mtl").write_text("newmtl skin\nKd 1 1 1\nmap_Kd t.png\n")
    (folder / "t.obj").write_text(
        "mtllib t.mtl\nusemtl skin\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
        "vt 0.1 0.1\nvt 0.3 0.1\nvt 0.2 0.9\nvt 0.7 0.1\nvt 0.9 0.1\nvt 0.8 0.9\n"
        "f 1/1 2/2 3/3\nf 1/4 2/5 4/6\n"
    )
    return folder / "t.obj"


def test_a_texture_is_looked_up_at_the_middle_of_each_face(tmp_path):
    mesh = meshes.read_mesh(write_textured(tmp_path))
    colors = mesh.visual.face_colors[:, :3].tolist()
    assert sorted(colors) == [[10, 10, 200], [200, 10, 10]]
    assert mesh.metadata["flaw"] == ""


@pytest.mark.parametrize("name", ["t.png", "t.mtl"])
def test_what_is_cut_leaves_plain_colours_and_is_noted(tmp_path, name):
    path, cut = write_textured(tmp_path), tmp_path / name
    cut.write_bytes(cut.read_bytes()[: 60 if name == "t.png" else 7])
    mesh = meshes.read_mesh(path)
    assert mesh.metadata["flaw"] == f"lacks {name}"
    assert len(np.unique(mesh.visual.face_colors, axis=0)) == 1


def test_parts_of_a_scene_are_put_in_place(tmp_path):
    scene = trimesh.Scene()
    box = trimesh.creation.box(extents=[1, 1, 1])
    box.visual.face_colors = [0, 200, 0, 255]
    for x in (0.0, 5.0):
        place = trimesh.transformations.translation_matrix([x, 0, 0])
        scene.add_geometry(box, geom_name="box", transform=place)
    scene.export(tmp_path / "two.glb")
    mesh = meshes.read_mesh(tmp_path / "two.glb")
    np.testing.assert_allclose(mesh.bounds, [[-0.5] * 3, [5.5, 0.5, 0.5]])
    assert len(mesh.faces) == 24
    assert (mesh.visual.face_colors[:, :3] == [0, 200, 0]).all()


def test_a_file_without_colours_is_grey_and_a_stray_vertex_does_not_count(tmp_path):
    (tmp_path / "a.ply").write_text(PLY.format(4) + "9 9 9\n3 0 1 2\n")
    mesh = meshes.read_mesh(tmp_path / "a.ply")
    assert len(mesh.vertices) == 3
    np.testing.assert_allclose(mesh.extents, [1, 1, 0])
    assert (mesh.visual.face_colors == meshes.PLAIN).all()


def test_names_in_an_old_encoding_and_with_backslashes_do_not_matter(tmp_path):
    place = tmp_path / "m"
    place.mkdir()
    (place / "b.obj").write_bytes(
        "# dessiné\r\nmtllib .\\b.mtl\r\nv 0 0 0\r\nv 1 0 0\r\nv 0 1 0\r\n"
        "usemtl bleuté\r\nf 1 2 3".encode("latin-1")
    )
    (place / "b.mtl").write_bytes("newmtl bleuté\nKd 0 0 1\n".encode("latin-1"))
    colors = meshes.read_mesh(place / "b.obj").visual.face_colors
    np.testing.assert_array_equal(colors[:, :3], [[0, 0, 255]])


@pytest.mark.parametrize(
    "name, content, message",
    [
        ("bad.stl", b"\x00\x01garbage", "readable mesh in|faces in"),
        ("bad.glb", b"glTF....", "readable mesh in"),
        ("points.obj", b"v 0 0 0\nv 1 1 1\n", "readable mesh in|faces in"),
        ("nan.obj", b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "finite coordinates in"),
        ("dot.obj", b"v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n", "extent in"),
        ("long.stl", b"\xff" * 84 + b"\x81" * 50, "neither text nor whole|faces in"),
        ("far.ply", (PLY.format(3) + "3 0 1 7\n").encode(), "index is out of range"),
    ],
)
def test_a_broken_file_is_refused_by_name(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=message) as caught:
        meshes.read_mesh(tmp_path / name)
    assert name in str(caught.value)
