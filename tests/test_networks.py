"""The networks: nothing that a run does not learn, and where outputs start and end.

The paper's layers are in tests/test_main_paper_settings.py.
"""

import functools
import itertools

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dpc_jax import rotation_angle_deg
from dpc_jax.networks import ImageEncoder, PoseStudent, ShapeHead, ShapePoseNetwork
from dpc_jax.networks.encoder import measure_tint
from dpc_jax.networks.pose import (
    BoundedHead,
    PoseEnsemble,
    PoseSelector,
    spread_rotations,
)
from dpc_jax.networks.shape import LARGEST_SIZE, SMALLEST_SIZE, bound_sizes
from dpc_jax.networks.voxels import DoublingConv, VoxelHead

KEY = jax.random.key(0)


def shapes_of(module, *inputs):
    """Shapes of the parameters by path; nothing is computed."""
    tree = jax.eval_shape(module.init, KEY, *inputs)["params"]
    leaves = jax.tree_util.tree_flatten_with_path(tree)[0]
    return {"/".join(k.key for k in path): leaf.shape for path, leaf in leaves}


def begin(module, inputs):
    """Output of a module and its fresh parameters, in one compiled call."""
    return jax.jit(module.init_with_output)(KEY, inputs)


def run(module, inputs):
    return begin(module, inputs)[0]


def image_shape(size, channels=3):
    return jax.ShapeDtypeStruct((2, size, size, channels), jnp.float32)


ENCODER, CLOUD = ImageEncoder(2, 8), ShapeHead(num_points=10, hidden=8)
HEADS = PoseEnsemble(num_heads=4, hidden=8)


def network_shapes(inputs=3, shape=CLOUD, **others):
    network = ShapePoseNetwork(ENCODER, shape, HEADS, PoseStudent(8), **others)
    return shapes_of(network, image_shape(16, inputs))


def test_a_mixture_of_images_is_made_after_the_first_dense_layer():
    encoder = ImageEncoder(channels=2, hidden=8, normalize=True)
    images = jax.random.normal(KEY, (2, 16, 16, 3))
    mix = jnp.array([[1.0, 0.0], [0.0, 1.0], [0.25, 0.75]])

    def is_dense(module, _):
        return isinstance(module, nn.Dense)

    alone, variables = begin(encoder, images)
    mixing = functools.partial(encoder.apply, capture_intermediates=is_dense)
    mixed, seen = jax.jit(mixing)(variables, images, mix=mix)
    # Weights of 0 and 1 leave each image's activations as they are.
    np.testing.assert_allclose(mixed[:2], alone, rtol=1e-5, atol=1e-6)  # float32
    first, second = (seen["intermediates"][f"Dense_{i}"]["__call__"] for i in (0, 1))
    assert first[0].shape == (2, 8) and second[0].shape == (3, 8)
    # Behind it only the second layer follows; its input is linear in the weights.
    between = 0.25 * second[0][0] + 0.75 * second[0][1]
    # Sums of 8 products in float32.
    np.testing.assert_allclose(second[0][2], between, atol=1e-5)
    assert np.abs(mixed[2] - (0.25 * alone[0] + 0.75 * alone[1])).max() > 1e-3


@pytest.mark.parametrize("size", [0, 8, 48])
def test_an_image_size_that_cannot_be_halved_to_four_is_refused_in_a_sentence(size):
    with pytest.raises(ValueError, match=rf"power of two.*but it is {size}; use"):
        shapes_of(ImageEncoder(channels=2, hidden=4), image_shape(size))


def test_a_single_regressor_is_its_own_student_and_one_that_selects_has_logits():
    images = jnp.ones((2, 16, 16, 3))
    single = run(ShapePoseNetwork(ENCODER, CLOUD, PoseEnsemble(1, 8)), images)
    assert single["candidates"].shape == (2, 1, 4)
    np.testing.assert_array_equal(single["student"], single["candidates"][:, 0])
    heads = PoseEnsemble(3, 8), PoseSelector(12, 8)
    selecting = run(ShapePoseNetwork(ENCODER, CLOUD, *heads), images)
    assert selecting["logits"].shape == (2, 12) and "student" not in selecting


def test_the_shape_branch_has_colours_and_sizes_where_they_are_learned():
    plain = network_shapes()
    colors = {"shape/colors/bias": (30,), "shape/colors/kernel": (8, 30)}
    assert network_shapes(shape=CLOUD.clone(has_color=True)) == plain | colors
    sizes = {"shape/sizes/bias": (10,), "shape/sizes/kernel": (8, 10)}
    assert network_shapes(shape=CLOUD.clone(point_size="sigma")) == plain | sizes
    full = {"shape/sizes/bias": (30,), "shape/sizes/kernel": (8, 30)}
    full |= {"shape/turns/bias": (40,), "shape/turns/kernel": (8, 40)}
    assert network_shapes(shape=CLOUD.clone(point_size="covariance")) == plain | full


def test_a_tint_adds_one_number_per_point_and_reaches_colours_alone():
    learns = dict(shape=CLOUD.clone(has_color=True))
    learns |= dict(translation=BoundedHead(3, 0.15), focal=BoundedHead(1, 0.3))
    colored, tinted = network_shapes(**learns), network_shapes(**learns, is_tinted=True)
    assert {**colored, "shape/tint": (1, 10, 1)} == tinted
    heads = {"pose": PoseEnsemble(2, 8), "student": PoseStudent(8)}
    network = ShapePoseNetwork(ENCODER, **heads, **learns, is_tinted=True)
    features = jax.random.normal(KEY, (1, 8))

    def predict(module, tint):
        seen = jnp.concatenate([features, tint], axis=-1)
        rest = module.predict_pose(seen) | module.predict_camera(seen)
        return module.predict_shape(seen) | rest

    images = jnp.zeros((1, 16, 16, 3))
    params = jax.jit(network.init)(KEY, images)
    apply = jax.jit(nn.apply(predict, network))
    dark, light = (apply(params, jnp.full((1, 3), tint)) for tint in (-1.0, 1.0))
    changed = {name for name in dark if not np.array_equal(dark[name], light[name])}
    assert changed == {"colors"}
    assert np.all(np.asarray(light["colors"]) > np.asarray(dark["colors"]))
    # Around that of the config.
    np.testing.assert_allclose(light["focal_lengths"], 1.875, rtol=0.3)


def test_the_tint_is_that_of_the_object_without_the_background():
    images = np.full((3, 8, 8, 3), 1.0, np.float32)
    images[0, 2:4, 3:6] = 2 * np.array([0.8, 0.3, 0.5]) - 1
    images[1, 1] = -1.0  # black: bounded, so that its logit is finite
    found = jax.nn.sigmoid(measure_tint(jnp.asarray(images)))
    # float32; the last image is all white
    expected = [[0.8, 0.3, 0.5], [0.02] * 3, [0.5] * 3]
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_points_stay_in_the_cube_and_colours_and_scale_in_the_unit_interval():
    head = ShapeHead(num_points=50, hidden=16, has_color=True)
    # Features far beyond training's drive tanh and the sigmoids to their ends.
    features = jax.random.normal(KEY, (3, 8)) * 1e4
    shape = run(head, features)
    assert shape["points"].shape == shape["colors"].shape == (3, 50, 3)
    assert shape["scale"].shape == (3,)
    assert float(jnp.max(jnp.abs(shape["points"]))) <= 0.5
    for name in ("scale", "colors"):
        assert 0 <= float(jnp.min(shape[name])) <= float(jnp.max(shape[name])) <= 1


@pytest.mark.parametrize("count, least", [(1, 0), (2, 170), (4, 100), (8, 75)])
def test_initial_rotations_are_spread_over_so3(count, least):
    # The best possible pairwise angles are 180°, 120° (4 of the 24 cells' centres) and
    # about 90°; a greedy choice from a pool stays some degrees below.
    rotations = spread_rotations(count)
    assert rotations.shape == (count, 4)
    np.testing.assert_array_equal(rotations[0], [1, 0, 0, 0])
    np.testing.assert_allclose(np.linalg.norm(rotations, axis=-1), 1, atol=1e-6)
    pairs = itertools.combinations(rotations, 2)
    assert min((rotation_angle_deg(*pair) for pair in pairs), default=1) > least


def test_heads_start_near_their_rotations_yet_depend_on_the_image():
    ensemble = PoseEnsemble(num_heads=4, hidden=64, spreads=True)
    features = jax.random.normal(KEY, (20, 64))
    candidates = np.asarray(run(ensemble, features))
    assert candidates.shape == (20, 4, 4)
    angles = rotation_angle_deg(candidates, spread_rotations(4))
    # Heads are at least 100° apart: within 50° each is nearest to its own rotation.
    assert np.median(angles) < 50
    assert np.min(np.std(candidates, axis=0)) > 1e-3


def test_normalisation_makes_features_independent_of_contrast():
    image = jax.random.uniform(KEY, (1, 16, 16, 3), minval=-1)
    images = jnp.concatenate([image, image / 4])
    encoder = ImageEncoder(channels=2, hidden=8)
    plain, normal = (run(encoder.clone(normalize=f), images) for f in (False, True))
    # Without biases every layer is linear but for its leaky ReLU: a quarter in, a
    # quarter out, to rounding. With normalisation the factor divides out, up to the
    # 1e-6 added to the variance of the first layer, here of order 1e-2: 1e-3, relative.
    np.testing.assert_allclose(plain[1], plain[0] / 4, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(normal[1], normal[0], rtol=1e-2, atol=1e-3)
    assert np.max(np.abs(normal[0] - plain[0])) > 0.1


def test_normalisation_of_a_blank_image_is_finite_with_a_finite_gradient():
    encoder = ImageEncoder(channels=2, hidden=8, normalize=True)

    @jax.jit
    def differentiate(images):
        params = encoder.init(KEY, images)
        return jax.value_and_grad(lambda x: jnp.sum(encoder.apply(params, x) ** 2))(
            images
        )

    value, gradient = differentiate(jnp.zeros((1, 16, 16, 3)))
    assert np.isfinite(value) and np.all(np.isfinite(gradient))


def test_learned_sizes_start_near_the_first_one_and_turns_near_the_identity():
    head = ShapeHead(num_points=10, point_size="covariance", first_size=0.07)
    shape = run(head, jax.random.normal(KEY, (4, 256)))
    assert isinstance(shape, dict)
    assert shape["sizes"].shape == (4, 10, 3) and shape["turns"].shape == (4, 10, 4)
    # A tenth of the spread that points start with, times the slope of the logarithm.
    np.testing.assert_allclose(jnp.log(shape["sizes"] / 0.07), 0, atol=0.6)
    assert len(np.unique(np.asarray(shape["sizes"][0, 0]))) == 3
    turns = shape["turns"] / jnp.linalg.norm(shape["turns"], axis=-1, keepdims=True)
    assert float(jnp.min(turns[..., 0])) > 0.8


@pytest.mark.parametrize("first", [0.0, 0.003, 0.05, 0.3, 1.0])
def test_sizes_stay_between_their_bounds_and_have_finite_gradients(first):
    outputs = jnp.array([-1e30, -50.0, 0, 50, 1e30])
    sizes = bound_sizes(outputs, first=first)
    assert np.all((sizes >= SMALLEST_SIZE * 0.999) & (sizes <= LARGEST_SIZE * 1.001))
    slope = jax.vmap(jax.grad(lambda x: bound_sizes(x, first=first)))(outputs)
    assert np.all(np.isfinite(slope)) and float(slope[2]) > 0
    if 0.01 < first < 0.2:
        assert float(sizes[2]) == pytest.approx(first, rel=1e-5)


# Camera branches.


def test_camera_heads_start_near_the_middle_and_stay_in_range():
    head = BoundedHead(outputs=3, bound=0.15)
    features = jax.random.normal(jax.random.key(1), (5, 8))
    first, params = begin(head, features)
    assert first.shape == (5, 3)
    assert np.abs(first).max() < 0.1 and np.std(first, axis=0).min() > 0
    far = np.asarray(head.apply(params, 1e4 * features))
    assert np.abs(far).max() <= 0.15


def test_an_encoder_that_sees_masks_has_a_fourth_channel_and_refuses_three():
    plain, masked = network_shapes(), network_shapes(inputs=4, sees_mask=True)
    first = "encoder/Conv_0/kernel"
    assert plain[first][2] == 3 and masked[first][2] == 4
    assert {**plain, first: masked[first]} == masked
    with pytest.raises(AssertionError):
        network_shapes(sees_mask=True)


# Heads of voxel models.


def test_a_doubling_is_a_transposed_convolution_of_kernel_4_and_stride_2():
    x = jax.random.normal(jax.random.key(0), (2, 4, 4, 4, 3))
    found, params = begin(DoublingConv(5), x)
    # Tap i of place a is cell 2i + a of the kernel.
    taps = params["params"]["kernel"].reshape(2, 2, 2, 3, 2, 2, 2, 5)
    kernel = taps.transpose(0, 4, 1, 5, 2, 6, 3, 7).reshape(4, 4, 4, 3, 5)
    expected = jax.lax.conv_general_dilated(
        x,
        kernel,
        window_strides=(1, 1, 1),
        padding=[(2, 2)] * 3,
        lhs_dilation=(2, 2, 2),
        dimension_numbers=("NDHWC", "DHWIO", "NDHWC"),
    )
    np.testing.assert_allclose(found, expected, atol=1e-5)  # sums of 24 products


def test_the_first_volume_is_thin_and_contained_where_that_is_asked_for():
    side, features = 16, jax.random.normal(jax.random.key(0), (2, 16))
    shape, params = begin(VoxelHead(side, channels=4), features)
    assert set(shape) == {"cells"} and "colors" not in params["params"]
    cells = shape["cells"]
    np.testing.assert_allclose(cells, 0.05, atol=0.03)
    assert np.all(np.asarray(jnp.abs(cells[0] - cells[1])) > 0)  # of each its own
    held = VoxelHead(side, channels=4, is_contained=True, has_color=True)
    shape = run(held, features)
    assert shape["colors"].shape == (2, side, side, side, 3)
    axis = (np.arange(side) + 0.5) / side - 0.5
    radius = np.linalg.norm(np.stack(np.meshgrid(axis, axis, axis)), axis=0)
    expected = np.where(radius <= 0.5, cells, 0)
    np.testing.assert_allclose(shape["cells"], expected, rtol=1e-5)  # float32
    assert 0 < np.mean(expected == 0) < 0.5  # the corners: 1 - pi/6
