"""Parts and keypoints of procedural shapes."""

import numpy as np
import pytest

from dpc_jax.shapes import procedural
from dpc_jax.shapes.building_blocks import read_labels
from dpc_jax.shapes.keypoints import find_keypoints

SEEDS = range(12)
LABELS = {
    "chair": {"seat", "back", "leg"},
    "car": {"body", "cabin", "wheel"},
    "airplane": {"body", "wing", "tail", "engine"},
}
OPTIONAL = {"chair": {"arm"}, "car": {"extra"}, "airplane": {"gear"}}
# Sums over these shapes: of faces, of their colours, of mean absolute coordinates.
KNOWN = {
    "car": (10800, 5440012, 1.9761665135797009),
    "chair": (3716, 1947844, 2.1089268167066355),
    "airplane": (7584, 4915512, 1.201935868526995),
}


def find_part(mesh, label):
    """Corners [F, 3, 3] of the faces of a part."""
    return mesh.vertices[mesh.faces[read_labels(mesh) == label]]


@pytest.mark.parametrize("category", procedural.CATEGORIES)
def test_shapes_are_those_that_data_sets_were_rendered_from(category):
    meshes = [procedural.make_shape(category, seed) for seed in SEEDS]
    faces = sum(len(mesh.faces) for mesh in meshes)
    size = sum(np.abs(mesh.vertices).mean() for mesh in meshes)
    colors = sum(int(mesh.visual.face_colors.sum()) for mesh in meshes)
    # Another number means that data sets change: then raise VERSION in data/dataset.py.
    # Sines may differ in their last bit between machines.
    assert (faces, colors) == KNOWN[category][:2]
    assert size == pytest.approx(KNOWN[category][2], rel=1e-9)


@pytest.mark.parametrize("category", procedural.CATEGORIES)
def test_every_face_belongs_to_a_part_of_its_category(category):
    for seed in SEEDS:
        mesh = procedural.make_shape(category, seed)
        labels = read_labels(mesh)
        assert labels.shape == (len(mesh.faces),)
        assert LABELS[category] <= set(labels) <= LABELS[category] | OPTIONAL[category]


def test_parts_lie_where_their_names_say():
    for seed in SEEDS:
        chair = procedural.make_shape("chair", seed)
        seat, back = (find_part(chair, name)[..., 2] for name in ("seat", "back"))
        assert find_part(chair, "leg")[..., 2].mean() < seat.mean() < back.mean()
        car = procedural.make_shape("car", seed)
        wheel, body = (find_part(car, name)[..., 2] for name in ("wheel", "body"))
        assert wheel.mean() < body.mean() < find_part(car, "cabin")[..., 2].mean()
        airplane = procedural.make_shape("airplane", seed)
        assert find_part(airplane, "tail")[..., 0].max() < 0
        reach = np.abs(find_part(airplane, "wing")[..., 1]).max()
        assert reach == pytest.approx(airplane.bounds[1, 1])


@pytest.mark.parametrize("category", procedural.CATEGORIES)
def test_keypoints_are_on_their_part_and_left_and_right_are_alike(category):
    for seed in SEEDS:
        mesh = procedural.make_shape(category, seed)
        found = find_keypoints(category, seed)
        for name, point in found.items():
            corners = find_part(mesh, point.label).reshape(-1, 3)
            assert np.abs(corners - point.position).sum(-1).min() == 0, name
            if "left" in name:
                other = found[name.replace("left", "right")].position
                # Seats and legs are symmetric, yet a star may move the box's middle.
                np.testing.assert_allclose(
                    point.position[[0, 2]], other[[0, 2]], atol=1e-12
                )
                assert point.position[1] > other[1] + 0.1
            if "front" in name:
                rear = found[name.replace("front", "rear")].position
                assert point.position[0] > rear[0]


def test_a_chair_has_leg_tips_on_the_floor_or_none_at_all():
    tips = [
        [p.position[2] for n, p in find_keypoints("chair", seed).items() if "tip" in n]
        for seed in range(40)
    ]
    assert {len(heights) for heights in tips} == {0, 4}
    for seed, heights in enumerate(tips):
        floor = procedural.make_shape("chair", seed).bounds[0, 2]
        # The tubes of a sled reach half their width below their ends' rims.
        assert all(height - floor < 0.04 for height in heights)
