"""Float32 against float64 on ordinary scenes: images and every gradient."""

import itertools
from collections.abc import Iterator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dpc_jax.measure.scenes import Scene
from dpc_jax.render import Camera, VoxelGrid, project

SIGNALS = ("silhouette", "depth", "color")
SIDE = 32


class Method(NamedTuple):
    """A way to render."""

    name: str  # in the report
    method: str  # the argument of `project`
    # How a point's size is given, "shared" by all points, its "own", or a "covariance".
    size: str


METHODS = (
    Method("trilinear", "trilinear", "shared"),
    Method("gaussian", "gaussian", "shared"),
    Method("gaussian, σ per point", "gaussian", "own"),
    Method("gaussian, covariances", "gaussian", "covariance"),
)


class Comparison(NamedTuple):
    """The error of one array in float32, relative to its largest magnitude."""

    method: str
    scene: str
    signal: str
    quantity: str  # "image", or the input to which the gradient is taken
    error: float  # max |a - b| / max |b| with a in float32 and b in float64


def compare_scenes(
    scenes: list[Scene], *, methods: tuple[Method, ...], count: int
) -> Iterator[Comparison]:
    """Errors of each image and each gradient.

    The scalar that is differentiated is Σ w·image. Its weights are between -1 and 1 and
    are the same numbers in both dtypes. The first `count` points are taken of each
    scene, so that all share programs.
    """
    for method in methods:
        results = {}
        for dtype in ("float32", "float64"):
            with jax.enable_x64(dtype == "float64"):
                call = jax.jit(_make_call(method))
                for scene, signal in itertools.product(scenes, SIGNALS):
                    tree = (_make_inputs(scene, method, count), _make_weights(signal))
                    arrays = jax.tree.map(lambda a, d=dtype: jnp.asarray(a, d), tree)
                    results[scene.name, signal, dtype] = jax.device_get(call(*arrays))
        for scene, signal in itertools.product(scenes, SIGNALS):
            (image, gradients), (true_image, true_gradients) = (
                results[scene.name, signal, dtype] for dtype in ("float32", "float64")
            )
            error = _measure_error(image[signal], true_image[signal])
            yield Comparison(method.name, scene.name, signal, "image", error)
            for name, gradient in gradients.items():
                # An input without influence on the image has no gradient to it.
                if _reaches(name, signal):
                    error = _measure_error(gradient, true_gradients[name])
                    yield Comparison(method.name, scene.name, signal, name, error)


def _measure_error(found, reference):
    """Largest difference, relative to the largest magnitude of the reference."""
    reference = np.asarray(reference, np.float64)
    largest = np.max(np.abs(reference))
    difference = np.max(np.abs(np.asarray(found, np.float64) - reference))
    return float(difference / largest) if largest > 0 else float(difference)


def _make_inputs(scene, method, count):
    """Float64 numbers that float32 represents exactly, so both see the same scene."""
    rng = np.random.default_rng(count)
    inputs = {
        "points": scene.points[:count],
        "rotation": scene.pose,
        "scale": scene.mass * len(scene.points) / count / 8 * rng.uniform(0.8, 1.2),
        "colors": rng.uniform(0, 1, (count, 3)),
        "translation": np.array([0.02, -0.03, 0.01]),
        "focal_length": np.array(1.875),
        "distance": np.array(2.0),
        "background_depth": np.array(10.0),
        "background_color": np.array([1.0, 0.9, 0.8]),
    }
    if method.size == "shared":
        inputs["sigma"] = np.array(1.3)
    elif method.size == "own":
        inputs["sigma"] = rng.uniform(0.7, 2.5, count)
    else:
        axes = rng.normal(0, 0.8, (count, 3, 3))
        inputs["covariance"] = axes @ axes.transpose(0, 2, 1) + 0.3 * np.eye(3)
    return {k: np.asarray(v, np.float32).astype(np.float64) for k, v in inputs.items()}


def _make_call(method):
    """A function (inputs, weights by signal) -> (images, gradients of Σ w·image).

    One program serves all signals: for one of them, the others have zero weights.
    """

    def render(inputs):
        inputs = dict(inputs)
        camera = Camera(inputs.pop("focal_length"), inputs.pop("distance"))
        images = project(
            inputs.pop("points"),
            inputs.pop("rotation"),
            camera=camera,
            grid=VoxelGrid(SIDE),
            signals=SIGNALS,
            method=method.method,
            **inputs,
        )
        return {signal: getattr(images, signal) for signal in SIGNALS}

    def call(inputs, weights):
        images, pull_back = jax.vjp(render, inputs)
        (gradients,) = pull_back(weights)
        return images, gradients

    return call


def _make_weights(signal):
    """Weights by signal, [rows, cols] or [rows, cols, 3]; zero but for one signal."""
    shapes = {s: (SIDE, SIDE) for s in SIGNALS} | {"color": (SIDE, SIDE, 3)}
    weights = {s: np.zeros(shape, np.float32) for s, shape in shapes.items()}
    rng = np.random.default_rng(SIGNALS.index(signal))
    weights[signal] = rng.uniform(-1, 1, shapes[signal]).astype(np.float32)
    return weights


def _reaches(name, signal):
    """Whether an input has an influence on a signal."""
    if name == "colors":
        return signal == "color"
    if name.startswith("background_"):
        return name == f"background_{signal}"
    return True
