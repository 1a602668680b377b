"""Views against closed forms and a second renderer: area, depth, colour."""

import numpy as np
import pytest
import rasteriser
import trimesh
from rasteriser import DISTANCE, FOCAL
from scipy.spatial.transform import Rotation

from dpc_jax.data import DataSpec, rendering, viewpoints, views
from dpc_jax.shapes import procedural

LIGHTS = views.Lights(
    np.array([[0.6, 0, 0.8], [0, -0.8, 0.6]]), np.array([0.4, 0.3]), 0.3
)


def turn_to(azimuth, elevation):
    return viewpoints.look_at_rotation(np.deg2rad(azimuth), np.deg2rad(elevation))


def render(mesh, rotation, *, image_size=64, supersample=4, lights=LIGHTS):
    return views.render_view(
        mesh, rotation, lights=lights, image_size=image_size, supersample=supersample
    )


def cast_rays(image_size, supersample):
    """Sample directions [S, S, k * k, 3] with z = 1, in the camera frame."""
    count = image_size * supersample
    line = ((np.arange(count) + 0.5) / count - 0.5) / FOCAL
    v, u = np.meshgrid(line, line, indexing="ij")
    rays = np.stack([u, v, np.ones_like(u)], axis=-1)
    rays = rays.reshape(image_size, supersample, image_size, supersample, 3)
    return rays.swapaxes(1, 2).reshape(image_size, image_size, supersample**2, 3)


@pytest.mark.parametrize("place", [(0, 0, 0), (0.1, 0.25, -0.2), (-0.2, -0.3, 0.3)])
@pytest.mark.parametrize("angles", [(0, 0), (130, 35)])
def test_a_sphere_anywhere_has_the_area_and_the_depth_of_the_formula(place, angles):
    radius, size, k = 0.15, 64, 4
    # facets of 1.1 degrees: at most r (1 - cos 0.65 deg) = 1e-5 inside of the sphere
    ball = trimesh.creation.icosphere(subdivisions=6, radius=radius)
    ball.apply_translation(place)
    rotation = turn_to(*angles)
    view = render(ball, rotation, image_size=size, supersample=k)
    x, y, z = rotation @ place + [0, 0, DISTANCE]
    # the image of a sphere is an ellipse
    rest = z**2 - radius**2
    minor = FOCAL * radius / np.sqrt(rest) * size
    major = FOCAL * radius * np.sqrt(x**2 + y**2 + rest) / rest * size
    # samples are counted to about R^(2/3) of them (Gauss's circle problem; R = 4 * 9
    # samples: 11 of 16 to the pixel), and each of 60 rim pixels is rounded to 1/255
    assert abs((view.mask / 255.0).sum() - np.pi * major * minor) < 1.0
    rays = cast_rays(size, k)
    square, along = (rays**2).sum(-1), rays @ [x, y, z]
    root = along**2 - square * (x**2 + y**2 + z**2 - radius**2)
    exact = (along - np.sqrt(np.maximum(root, 0))) / square
    # pixels of which no ray grazes: cos 0.2 and the facets' 1e-5 make 5e-5
    steep = (root > 0.04 * radius**2 * square).all(axis=-1)
    assert steep.sum() > 100
    assert np.abs(view.depth - exact.mean(axis=-1))[steep].max() < 1e-4


@pytest.mark.parametrize("angles", [(30, 25), (200, -15), (45, 80)])
def test_a_turned_box_has_the_mask_and_the_depth_of_the_formula(angles):
    half, size, k = np.array([0.3, 0.2, 0.1]), 48, 4
    rotation = turn_to(*angles)
    view = render(
        trimesh.creation.box(extents=2 * half), rotation, image_size=size, supersample=k
    )
    # slabs: a ray is inside between its last entry and its first exit
    rays, eye = cast_rays(size, k) @ rotation, -DISTANCE * rotation[2]
    first, second = (-half - eye) / rays, (half - eye) / rays
    enter = np.minimum(first, second).max(axis=-1)
    leave = np.maximum(first, second).min(axis=-1)
    hit = enter < leave
    # float32 rays decide otherwise only where both are within 1e-6 of each other
    clear = (np.abs(enter - leave) > 1e-6).all(axis=-1)
    assert clear.mean() > 0.99
    expected = np.rint(255.0 * hit.mean(axis=-1))
    np.testing.assert_array_equal(view.mask[clear], expected[clear])
    depth = np.where(hit, enter, 0).sum(-1) / np.maximum(hit.sum(-1), 1)
    # float32 at 2.3 has steps of 2.4e-7, and slanted faces multiply them by up to 10
    np.testing.assert_allclose(view.depth[clear], depth[clear], atol=5e-6)


def make_bowl():
    """Half of a sphere, open upwards, each face of its own colour and turned anyhow."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.3)
    faces = ball.faces[(ball.triangles[:, :, 2] < 1e-9).all(axis=1)]
    colors = np.random.default_rng(0).integers(60, 256, (len(faces), 3))
    flip = np.random.default_rng(1).random(len(faces)) < 0.5
    faces = np.where(flip[:, None], faces[:, ::-1], faces)
    return trimesh.Trimesh(ball.vertices, faces, face_colors=colors, process=False)


def make_mesh(name):
    return make_bowl() if name == "bowl" else procedural.make_shape(name, 4)


@pytest.mark.parametrize("name", ["car", "chair", "airplane", "bowl"])
@pytest.mark.parametrize("angles", [(20, 35), (200, -20), (90, 1)])
def test_masks_depth_and_colours_are_those_of_a_second_renderer(name, angles):
    mesh, rotation = make_mesh(name), turn_to(*angles)
    view = render(mesh, rotation, image_size=32, supersample=3)
    mask, depth, image = rasteriser.render(
        mesh, rotation, image_size=32, supersample=3, lights=LIGHTS
    )
    # float32 rays and float64 edges decide differently only for samples within 1e-7 of
    # an edge; straight edges of symmetric shapes can lie there, a handful per image
    differing = np.abs(view.mask / 255.0 - mask) > 0.003
    assert differing.sum() <= 6
    same = ~differing & (mask > 0)
    assert same.sum() > 40
    # the same rounding decides which of two surfaces a sample sees, at inner edges
    assert np.mean(np.abs(view.depth[same] - depth[same]) > 1e-5) < 0.02
    # rounded to integers, half a unit; at faces that lie in one plane or touch, either
    # may be seen
    off = np.abs(view.image[same] - image[same]).max(axis=-1)
    assert np.mean(off > 0.51) < 0.03


def test_lights_are_one_to_three_and_come_from_all_sides():
    drawn = [views.draw_lights(np.random.default_rng(seed)) for seed in range(300)]
    counts = np.bincount([len(lights.strength) for lights in drawn], minlength=4)
    # binomial, n = 300, p = 1/3: 100 with a standard deviation of 8; five of them
    assert counts[0] == 0 and (np.abs(counts[1:] - 100) < 41).all()
    towards = np.concatenate([lights.towards for lights in drawn])
    quarter = 2 * (towards[:, 0] > 0) + (towards[:, 1] > 0)
    share = np.bincount(quarter, minlength=4) / len(quarter)
    # n about 600, p = 1/4: standard deviation 0.018; five of them
    assert (np.abs(share - 0.25) < 0.09).all()
    assert all(lights.ambient > 0 for lights in drawn)


def test_viewpoints_are_drawn_as_in_the_paper():
    """Azimuth uniform in 360 degrees, elevation in [-20, 40]."""
    spec = DataSpec("car", models=1, views=400, image_size=2)
    arrays = rendering.render_mesh(procedural.make_shape("car", 0), spec, 0)
    turns = Rotation.from_quat(arrays["quaternions"], scalar_first=True).as_matrix()
    away = -turns[:, 2]  # the camera's place, z forward
    azimuth = np.rad2deg(np.arctan2(away[:, 1], away[:, 0])) % 360
    elevation = np.rad2deg(np.arcsin(away[:, 2]))
    # Kolmogorov and Smirnov: 400 draws differ by 0.098 with a probability of 0.001
    for values, low, high in ((azimuth, 0, 360), (elevation, -20, 40)):
        level = (np.sort(values) - low) / (high - low)
        assert np.abs(level - (np.arange(400) + 0.5) / 400).max() < 0.098
