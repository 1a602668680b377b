"""The report's other parts: each runs, writes what it found, and can fail."""

import importlib.util

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tiny_runs import compiling_quickly

from dpc_jax.files import write_json
from dpc_jax.learning.training import loop
from dpc_jax.learning.training.records import NonFiniteError
from dpc_jax.measure.stability import (
    error_growth,
    fast_training,
    precision,
    precision_report,
)
from dpc_jax.measure.stability.draws import (
    learning_targets,
    random_draws,
    render_targets,
)
from dpc_jax.measure.stability.draws.targets import LARGEST, Range, Target
from dpc_jax.measure.stability.report_parts import PartRequest
from dpc_jax.measure.stability.stiff import descent, stiff_report, studies, summaries
from dpc_jax.render import VoxelGrid, project, quaternion

# Compiled in a second or two each; the others are drawn for in the slow test.
CHEAP = (
    "voxelize",
    "splat",
    "smooth",
    "opacity",
    "termination_probabilities",
    "mass_of_peak",
    "quaternion.",
    "_loss",
    "losses.",
    "chamfer",
    "pose_summary",
    "rotation_angle",
    "align",
)

TRIAL = fast_training.Trial("naive", 10, 30)


def assert_section(result, folder, *, title, figures=()):
    """A section with a heading of the second level, its figures, and plain data."""
    assert result.markdown.startswith(f"## {title}\n")
    for name in figures:
        assert f"({name})" in result.markdown
        assert (folder / name).read_bytes().startswith(b"\x89PNG")
    write_json(folder / "data.json", result.data)
    assert result.passes == (not result.failures)


def test_ordinary_scenes_are_within_tolerance_and_drawn(tmp_path):
    with compiling_quickly():
        result = precision_report.run_part(PartRequest(tmp_path, quick=True))
    title = "Ordinary scenes in float32"
    assert_section(result, tmp_path, title=title, figures=[precision_report.FIGURE])
    assert result.passes, result.failures


@pytest.mark.parametrize("error", [1.0, float("nan")])
def test_a_wrong_image_or_gradient_in_float32_fails(error):
    for quantity in ("image", "points"):
        found = precision.Comparison("trilinear", "car", "depth", quantity, error)
        (sentence,) = precision_report.judge([found], [])
        assert "car, depth" in sentence
    fine = precision.Comparison("trilinear", "car", "depth", "image", 1e-7)
    assert precision_report.judge([fine], []) == []


def test_an_error_that_grows_as_n_fails_and_one_as_the_root_does_not():
    sizes = (100, 1000, 10_000)
    for power, num_failures in ((0.5, 0), (1.0, 1)):
        errors = tuple(1e-7 * n**power for n in sizes)
        exponent = error_growth.fit_exponent(sizes, errors)
        np.testing.assert_allclose(exponent, power, rtol=1e-12)  # rounding of logs
        curve = error_growth.Curve("points", "sum", sizes, errors, exponent)
        assert len(precision_report.judge([], [curve])) == num_failures
    assert error_growth.fit_exponent(sizes, (1e-7, float("nan"), 1e-7)) == float("inf")


def test_random_draws_break_no_function(tmp_path):
    targets = [
        t for t in random_draws.list_targets() if any(c in t.name for c in CHEAP)
    ]
    with compiling_quickly():
        result = random_draws.run_part(
            PartRequest(tmp_path, quick=True), targets=targets
        )
    assert_section(result, tmp_path, title="Random draws")
    assert result.passes, result.failures
    assert all(row["draws"] >= random_draws.QUICK_DRAWS for row in result.data)


@pytest.mark.slow
def test_random_draws_break_no_renderer_either(tmp_path):
    result = random_draws.run_part(PartRequest(tmp_path, quick=True))
    assert result.passes, result.failures
    names = [row["target"] for row in result.data]
    assert len(set(names)) == len(names)
    assert len(names) == len(render_targets.list_targets()) + len(
        learning_targets.list_targets()
    )


def test_a_function_that_draws_break_is_named_with_the_draw(tmp_path):
    broken = [
        Target("an overflow", lambda x: x * 2, (Range((2,)),)),
        Target("a slope at zero", jnp.sqrt, (Range((), 0, 1, (0, 1)),)),
        Target(
            "a promise",
            lambda x: x,
            (Range((3,), 0, 2, (0, 2)),),
            holds=lambda found, _: {"in [0, 1]": jnp.all(found <= 1)},
        ),
        Target(
            "an exception",
            lambda x: 1 // int(x),
            (Range((), 0, 5, (0, 5)),),
            is_traced=False,
        ),
    ]
    result = random_draws.run_part(PartRequest(tmp_path), draws=200, targets=broken)
    assert not result.passes
    overflow, slope, promise, exception = result.failures
    assert "finite" in overflow
    assert "gradient of input 0" in slope and "for 0.0" in slope
    assert "in [0, 1]" in promise
    assert "ZeroDivisionError" in exception
    assert all(f"**{target.name}**" in result.markdown for target in broken)


def test_draws_reach_the_ends_of_the_float_range():
    seen = []

    def look(x):
        seen.append(float(x))
        return x

    target = Target("anything", look, (Range(()),), is_traced=False)
    random_draws.draw_inputs(target, draws=1000, seed=0)
    sizes = np.abs(seen)
    assert np.isfinite(sizes).all()
    assert sizes.max() == LARGEST and (sizes == 0).any()
    tiny = np.finfo(np.float32).tiny
    assert ((sizes > 0) & (sizes < tiny)).any()  # subnormal
    assert ((sizes > 1e-3) & (sizes < 0.5)).any()  # ordinary


def test_random_draws_say_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    result = random_draws.run_part(PartRequest(tmp_path, quick=True))
    assert not result.passes
    assert "hypothesis" in result.failures[0] and "install" in result.failures[0]


def test_training_ten_times_too_fast_ends_finite(tmp_path):
    with compiling_quickly():
        result = fast_training.run_part(PartRequest(tmp_path), trials=[TRIAL])
    assert_section(result, tmp_path, title="Training far too fast")
    assert result.passes, result.failures
    (ending,) = result.data
    assert ending["is_finite"] and ending["steps_done"] == 30


def test_training_that_stops_is_shown_with_its_reason(tmp_path, monkeypatch):
    def stop(*_, **__):
        raise NonFiniteError(
            "Expected finite losses and gradients, but the loss became nan at step 3; "
            "start a run in another workdir."
        )

    monkeypatch.setattr(loop, "train", stop)
    with compiling_quickly():
        result = fast_training.run_part(PartRequest(tmp_path), trials=[TRIAL])
    assert result.passes, result.failures
    assert "stopped: the loss became nan at step 3 |" in result.markdown


@pytest.mark.slow
def test_training_the_default_ten_times_too_fast_ends_finite(tmp_path):
    result = fast_training.run_part(PartRequest(tmp_path, quick=True))
    assert result.passes and result.data[0]["is_finite"], result.failures


def test_a_run_that_breaks_unnoticed_or_without_a_name_fails():
    good = fast_training.Ending(
        fast_training.Trial("", 10, 5), 1e-3, 5, 1.0, 2.0, 1.0, 3.0, True, ""
    )
    named = "Expected finite losses, but the student loss became nan at step 1; stop."
    stopped = good._replace(steps_done=None, is_finite=False, error=named)
    assert fast_training.judge(good) == fast_training.judge(stopped) == []
    for change, words in (
        ({"is_finite": False}, "unnoticed"),
        ({"steps_done": 3}, "3 of 5"),
        ({"error": "Out of memory"}, "without saying what"),
    ):
        (sentence,) = fast_training.judge(good._replace(**change))
        assert words in sentence


@pytest.fixture(scope="module")
def quick_descents(tmp_path_factory):
    folder = tmp_path_factory.mktemp("stiff")
    with compiling_quickly():
        return stiff_report.run_part(PartRequest(folder, quick=True)), folder


def test_stiff_descents_stay_finite_and_are_drawn(quick_descents):
    result, folder = quick_descents
    figures = [stiff_report.SHAPE_FIGURE, stiff_report.OTHER_FIGURE]
    assert_section(result, folder, title="Stiff optimisation", figures=figures)
    assert result.passes, result.failures
    recipes = {row["recipe"] for row in result.data["summaries"]}
    assert {studies.BEST, studies.STAGED} <= recipes


def make_summary(**changes):
    values = dict(
        study="shape",
        scene="chair",
        recipe=studies.BEST,
        rate=None,
        seconds=1.0,
        iterations=[0, 10],
        losses=[2.0, 1.0],
        first_errors=[30.0, 1.0],
        second_errors=[12.0, 5.0],
    )
    return summaries.Summary(**values | changes)


def test_the_best_recipe_is_held_to_its_bounds():
    few = summaries.Choice("chair", 1, 90.0, 0.1, 1.0)
    many = few._replace(starts=8, accuracy=0.7)
    fine = ([], [make_summary()], [few, many])
    assert stiff_report.judge(*fine, is_full=True) == []
    for change, words in (
        ({"losses": [1.0, 2.0]}, "did not fall"),
        ({"first_errors": [30.0, 20.0]}, "pose error"),
        ({"second_errors": [12.0, float("nan")]}, "Chamfer"),
        ({"study": "masses", "recipe": studies.STAGED}, "heavy points"),
    ):
        sentences = stiff_report.judge([], [make_summary(**change)], [], is_full=True)
        assert any(words in sentence for sentence in sentences)
    lost = many._replace(accuracy=0.2)
    (sentence,) = stiff_report.judge([], [], [few, lost], is_full=True)
    assert "8 starts" in sentence
    # Plain gradient descent may crawl: that is what the report shows.
    crawls = make_summary(recipe="gradient, σ 1", first_errors=[30.0, 29.0])
    assert stiff_report.judge([], [crawls], [], is_full=True) == []


def test_a_descent_that_is_not_finite_fails():
    end = descent.Start(np.zeros((4, 3)), np.ones((2, 4)))
    fine = descent.Trace(*(np.ones((2, 2)) for _ in range(4)), end=end)
    for trace, words in (
        (fine, []),
        (fine._replace(chamfer=np.array([1.0, np.nan])), ["not finite"]),
        (fine._replace(end=end._replace(points=np.full((4, 3), np.inf))), ["not fin"]),
    ):
        run = studies.Run("shape", "car", "gradient, σ 1", 0.1, 0, 1.0, trace)
        sentences = stiff_report.judge([run], [], [], is_full=False)
        assert len(sentences) == len(words)
        assert all(w in sentence for w, sentence in zip(words, sentences, strict=True))


# What the random draws found, held as they found it.


@pytest.mark.parametrize("size", [9e37, LARGEST])
def test_a_quaternion_near_the_largest_float_is_a_rotation(size):
    # 1 / 9e37 is subnormal, which the processor flushes to zero.
    found = quaternion.normalize(jnp.array([0, 0, size, -size], jnp.float32))
    half = np.sqrt(0.5)
    # A quotient, a square root and a sum of two: a few roundings of 6e-8.
    np.testing.assert_allclose(found, [0, 0, half, -half], rtol=5e-7)


@pytest.fixture(scope="module")
def project_with_gradient():
    """A function that gives the silhouette's sum, and both gradients of it."""

    def total(covariance, rotation):
        return project(
            jnp.zeros((1, 3)),
            rotation,
            covariance=covariance[None],
            grid=VoxelGrid(5),
        ).silhouette.sum()

    shapes = (jax.ShapeDtypeStruct(s, jnp.float32) for s in ((3, 3), (4,)))
    with compiling_quickly():
        call = jax.jit(jax.value_and_grad(total, argnums=(0, 1)))
        compiled = call.lower(*shapes).compile()
    return lambda *inputs: compiled(*(jnp.asarray(x, jnp.float32) for x in inputs))


def test_a_flat_covariance_turned_a_little_has_a_gradient(project_with_gradient):
    # A line along x, turned so that its depth variance is 1e-19: the factors of an
    # order of axes that is not its own overflow.
    line = np.diag([1.0, 0, 0])
    value, gradients = project_with_gradient(line, np.array([0, 0.5, 0, 4555501056]))
    level, expected = project_with_gradient(line, np.array([0.0, 0, 0, 1]))
    np.testing.assert_allclose(value, level, rtol=1e-6)  # the tilt is 2e-10
    np.testing.assert_allclose(gradients[0], expected[0], rtol=1e-5, atol=1e-6)
    assert np.all(np.isfinite(gradients[1]))


def test_a_matrix_that_is_no_covariance_gives_finite_numbers(project_with_gradient):
    # Variance 0 along x, yet "correlated" with y and z.
    matrix = -np.ones((3, 3)) + np.diag([1.0, 0, 0])
    value, gradients = project_with_gradient(matrix, np.array([0, -1, -5.7e19, 0]))
    assert np.isfinite(value)
    assert all(np.all(np.isfinite(g)) for g in gradients)
