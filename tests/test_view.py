"""The live view in a real browser: shapes of files, of a run, of an image given to it.

Needs Chromium, as tests/test_reporting_browser.py.
"""

import io
import json

import numpy as np
import pytest
import trimesh
import viser
from scipy.spatial.transform import Rotation

from dpc_jax.config import Render
from dpc_jax.data.viewpoints import look_at_rotation, matrix_to_quaternion
from dpc_jax.evaluation.rotations import view_angles
from dpc_jax.reporting.export import write_ply, write_surface
from dpc_jax.run.viewing import Candidates, ShownObject, ShownView
from dpc_jax.run.viewing.page import _FROM_GLTF, Page
from dpc_jax.run.viewing.shape_files import read_shapes

TEXT = "(document.body ? document.body.innerText : '')"


def make_files(folder):
    """A cloud with colours, its surface, and the poses of two views."""
    box = trimesh.creation.box((0.8, 0.3, 0.2))
    points = np.asarray(box.sample(200, seed=0))
    write_ply(folder / "box.ply", points, np.tile([1.0, 0, 0], (200, 1)))
    write_surface(folder / "box.glb", box.vertices, box.faces)
    poses = [{"quaternion": [1, 0, 0, 0]}, {"quaternion": [0, 1, 0, 0]}]
    (folder / "box.json").write_text(json.dumps({"views": poses}))
    return points, box


def test_a_cloud_its_surface_and_its_views_are_one_shape_in_the_object_frame(tmp_path):
    points, box = make_files(tmp_path)
    (one,) = read_shapes([tmp_path])
    assert one.name == "box" and len(one.views) == 2
    np.testing.assert_allclose(one.points, points, atol=1e-7)  # float32 in the file
    np.testing.assert_array_equal(one.colors, np.tile([1.0, 0, 0], (200, 1)))
    turned = Rotation.from_quat(_FROM_GLTF, scalar_first=True)
    upright = trimesh.load(io.BytesIO(one.surface), file_type="glb").to_mesh()
    corners = turned.apply(np.array(upright.bounds))
    np.testing.assert_allclose(corners, box.bounds, atol=1e-6)


def test_a_surface_is_the_same_whatever_its_file(tmp_path):
    box, colors = trimesh.creation.box((0.8, 0.3, 0.2)), np.full((8, 3), 0.5)
    for name in ("a.glb", "b.ply", "c.obj"):
        write_surface(tmp_path / name, box.vertices, box.faces, colors)
    for one in read_shapes([tmp_path]):
        assert one.surface == (tmp_path / "a.glb").read_bytes()


def make_view(azimuth):
    pose, other = (
        matrix_to_quaternion(look_at_rotation(*np.radians(angles)))
        for angles in ((azimuth, 10), (azimuth + 90, 20))
    )
    others = np.stack([pose, other])
    candidates = Candidates(others, np.array([0.75, 0.25]), np.array([3.5, 71.5]))
    image = np.full((16, 16, 3), 200, np.uint8)
    return ShownView(pose, image, np.ones((16, 16)), candidates)


@pytest.fixture
def page():
    server = viser.ViserServer("127.0.0.1", 8470, verbose=False)
    yield Page(server, Render()), f"http://127.0.0.1:{server.get_port()}"
    server.stop()


def test_shapes_views_and_candidates_are_shown_and_an_image_may_be_given(
    browser, page, tmp_path
):
    shown, address = page
    points = np.random.default_rng(0).uniform(-0.3, 0.3, (500, 3))
    views = (make_view(30.0), make_view(75.0))
    shown.show([ShownObject("first", points, views=views)])
    given = []

    def predict(path):
        given.append(path.name)
        if path.suffix == ".txt":
            raise ValueError(f"Expected a readable image in {path}; check it.")
        return [ShownObject("from an image", 2 * points)]

    shown.add_upload(predict)
    browser.requests.clear()
    browser.page.goto(address)
    browser.wait_for(f"{TEXT}.includes('azimuth 30°, elevation 10°')")
    assert "0.75" in browser.ask(TEXT) and "71.5" in browser.ask(TEXT)
    browser.wait_for("document.querySelectorAll('canvas').length > 0")

    for name, answer in (
        ("car.txt", "Expected a readable image"),
        ("car.png", "Shape of"),
    ):
        (tmp_path / name).write_bytes(b"content")
        browser.page.set_input_files("input[type=file]", tmp_path / name)
        browser.wait_for(f"{TEXT}.includes({json.dumps(answer)})")
        # No path of the server's own folders is told.
        assert "/tmp" not in browser.ask(TEXT)
    assert given == ["car.txt", "car.png"]
    inputs = "[...document.querySelectorAll('input')].map(i => i.value)"
    assert "2. from an image" in browser.ask(inputs)
    # The next checkpoint of a run.
    shown.show([ShownObject("second", points, views=views)])
    shown.say("Later.")
    browser.wait_for(f"{TEXT}.includes('Later.')")
    assert "2. from an image" in browser.ask(inputs)
    assert browser.errors == []
    assert all("127.0.0.1" in url for url in browser.requests)


def test_a_camera_stands_where_its_view_is_taken_from(page):
    shown, _ = page
    node = shown._add_camera("/camera", make_view(30.0).pose, (0, 0, 0))
    x, y, z = node.position
    angles = np.degrees([np.arctan2(y, x), np.arcsin(z / np.linalg.norm([x, y, z]))])
    np.testing.assert_allclose(angles, view_angles(make_view(30.0).pose), atol=1e-6)
