"""Extreme cases of every public function, and the command that reports them."""

import importlib.util
import json
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tiny_runs import compiling_quickly

from dpc_jax import stability
from dpc_jax.measure.stability import DTYPES, SUBJECTS, descents, random_draws, runner
from dpc_jax.measure.stability.case import Case, Row
from dpc_jax.measure.stability.descent import Trace
from dpc_jax.measure.stability.draw_targets import (
    LARGEST,
    Range,
    Target,
    is_share,
    list_targets,
)
from dpc_jax.measure.stability.runner import compare, run_cases

TABLES = [subject for subject in SUBJECTS if subject not in ("random", "descent")]
# Compiled in a second or two each; all are drawn for in the slow test.
CHEAP = ("splat", "opacity", "mass_of_peak", "from_axis_angle", "_loss", "align")


def make_case(function, **changes):
    """A case of x², for which `function` stands in."""
    values = {
        "name": "a square",
        "function": function,
        "inputs": ([0.5, -2.0, 3.0],),
        "oracle": lambda x: x * x,
        "value_tolerance": 2,
        "gradient_tolerance": 2,
        "because": "one product",
    }
    return Case(**values | changes)


def run_made_up(*cases, **options):
    return list(run_cases("made up", cases, **options))


def describe_failures(rows):
    assert rows
    return "\n".join(row.describe_failure() for row in rows if not row.passes)


# The suite's extremes: float32 under `vmap`, compiled with less effort, because that
# takes the time. The slow test runs everything.
@pytest.mark.parametrize("subject", TABLES)
def test_every_case_is_within_its_tolerance(subject):
    dtype = "float64" if subject == "evaluation" else "float32"  # of numpy
    with compiling_quickly():
        rows, _ = runner.run_subject(subject, dtypes=(dtype,), quick=True)
    assert not describe_failures(rows)
    assert all(row.because for row in rows)


@pytest.mark.slow
@pytest.mark.parametrize("subject", SUBJECTS)
def test_every_case_is_within_its_tolerance_in_every_dtype_both_ways(subject, tmp_path):
    quick = subject == "random"  # in full it takes half an hour
    rows, _ = runner.run_subject(subject, out=tmp_path, quick=quick)
    assert not describe_failures(rows)


def test_a_right_function_passes_in_every_dtype():
    rows = run_made_up(make_case(lambda x: x * x))
    assert [row.dtype for row in rows] == list(DTYPES)
    assert all(row.passes and row.is_finite for row in rows)


def test_a_function_that_is_wrong_by_a_thousandth_fails():
    (row,) = run_made_up(make_case(lambda x: 1.001 * x * x), dtypes=("float32",))
    assert not row.passes and row.is_finite
    # Relative to the largest, 9, and of the gradient to the largest slope.
    assert row.value_error == pytest.approx(1e-3, rel=1e-3)
    assert row.gradient_error == pytest.approx(1e-3, rel=1e-3)


def test_a_wrong_gradient_of_a_right_value_fails():
    wrong = make_case(lambda x: x * x + 0.01 * (x - jnp.round(x * 2) / 2))
    (row,) = run_made_up(wrong, dtypes=("float32",))
    assert row.value_ratio <= 1
    assert not row.passes and row.gradient_ratio > 1


def test_a_function_without_an_oracle_is_compared_with_itself_in_float64():
    case = make_case(lambda x: jnp.sum(x * 0.1), oracle=None, dtypes=("float32",))
    (row,) = run_made_up(case)
    assert row.passes and row.value_error > 0
    rough = make_case(
        lambda x: jnp.sum(x * 0.1) + (0.01 if x.dtype == jnp.float32 else 0),
        oracle=None,
        dtypes=("float32",),
    )
    (row,) = run_made_up(rough)
    assert not row.passes


def test_nan_is_not_finite_and_fails_even_where_no_more_is_asked():
    case = make_case(lambda x: x * x + jnp.sqrt(-jnp.abs(x)), half="finite")
    with jax.debug_nans(False):
        rows = run_made_up(case, dtypes=("float32", "bfloat16"))
    assert not any(row.is_finite or row.passes for row in rows)
    assert not Row("descent", "lost", "float32", float("nan"), 1.0).passes


def test_a_gradient_alone_that_is_infinite_fails():
    case = make_case(lambda x: x * x + 0 * jnp.sqrt(jnp.abs(x - 0.5)))
    with jax.debug_nans(False):
        (row,) = run_made_up(case, dtypes=("float32",))
    assert row.value_ratio <= 1
    assert not row.is_finite and not row.passes


def test_an_oracle_that_is_not_finite_judges_nothing():
    case = make_case(
        lambda x: x, oracle=lambda x: np.full(3, np.inf), gradient_tolerance=None
    )
    with pytest.raises(FloatingPointError, match="judges nothing"):
        run_made_up(case, dtypes=("float32",))


def test_an_output_of_another_shape_is_infinitely_wrong():
    assert compare([np.ones(2)], [np.ones(3)], "float32") == np.inf


def test_derivatives_of_oracles_have_all_digits():
    def oracle(x):
        return np.exp(x) / (1 + x * x)

    (slope,) = runner.differentiate_oracle(oracle, (np.array([0.7]),), [np.ones(1)])
    x = np.longdouble(0.7)
    expected = np.exp(x) * (1 - x) ** 2 / (1 + x * x) ** 2
    # Ten roundings of long double, of 1e-19 each; float64 where there is none.
    assert abs(slope[0] - expected) < 20 * np.finfo(np.longdouble).eps


def draw(targets, *, draws):
    return list(random_draws.run(targets, draws=draws, seed=0, tell=lambda _: None))


def test_random_draws_break_no_function():
    targets = [t for t in list_targets() if any(c in t.name for c in CHEAP)]
    with compiling_quickly():
        rows = draw(targets, draws=random_draws.QUICK_DRAWS)
    assert len(rows) == len(targets) > len(CHEAP)
    assert not describe_failures(rows)


def test_a_function_that_draws_break_is_named_with_the_draw():
    plain = {"is_traced": False}
    broken = [
        Target("an overflow", lambda x: x * 2, (Range((2,)),)),
        Target("a slope at zero", jnp.sqrt, (Range((), 0, 1, (0, 1)),)),
        Target("a promise", lambda x: x, (Range((3,), 0, 2, (0, 2)),), is_share),
        Target("an error", lambda x: 1 // int(x), (Range((), 0, 5, (0, 5)),), **plain),
    ]
    rows = draw(broken, draws=200)
    assert not any(row.passes for row in rows)
    overflow, slope, promise, exception = (row.describe_failure() for row in rows)
    assert "finite did not hold" in overflow
    assert "gradient of input 0" in slope and "for 0.0" in slope
    assert "its promise" in promise
    assert "ZeroDivisionError" in exception


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


def test_random_draws_say_what_to_install(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    (row,) = draw(list_targets(), draws=1)
    assert not row.passes
    assert "hypothesis" in row.describe_failure() and "install" in row.found


def test_the_package_runs_without_hypothesis():
    code = "import sys; sys.modules['hypothesis'] = None; "
    code += "from dpc_jax.measure.stability import random_draws"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_stiff_descents_stay_finite_and_are_drawn(tmp_path):
    with compiling_quickly():
        rows, section = descents.run(is_quick=True, out=tmp_path)
    assert not describe_failures(rows)
    assert f"({descents.FIGURE})" in section
    assert (tmp_path / descents.FIGURE).read_bytes().startswith(b"\x89PNG")
    for recipe in (descents.BEST, descents.STAGED):
        assert f"| {recipe} |" in section
        assert any(recipe in row.case and row.value_tolerance == 1 for row in rows)


def make_run(problem="shape", recipe=descents.BEST, end=1.0, **changes):
    """A descent whose every error falls from 10 to `end`."""
    errors = np.array([10.0, end])
    trace = Trace(
        *(np.outer(errors, np.ones(6)), np.outer(errors, np.ones(6)), errors),
        *(np.outer(errors, np.ones(6)) / 1e4, (np.zeros((6, 3)), np.ones((6, 4)))),
    )
    trace = trace._replace(**changes)
    return descents.Run(problem, "car", recipe, None, 0, 1.0, trace)


def judge(run):
    rows = list(descents.judge([run], is_full=True))
    return [row.case.rpartition(": ")[2] for row in rows if not row.passes]


def test_the_best_recipe_is_held_to_its_bounds():
    assert judge(make_run()) == []
    rises = np.outer([1.0, 2.0], np.ones(6))
    assert judge(make_run(losses=rises)) == ["last loss over first"]
    assert judge(make_run(pose_errors=30 * rises)) == ["pose error (degrees)"]
    unknown = np.array([10.0, np.nan])
    assert "Chamfer distance (x100)" in judge(make_run(chamfer=unknown))
    heavy, light = judge(make_run("masses", descents.STAGED, distances=rises))
    assert "heavy" in heavy and "light" in light
    assert judge(make_run("starts", pose_errors=30 * rises)) == ["views lost with 1"]
    # Plain gradient descent may crawl: that is what the report shows.
    assert judge(make_run(recipe="gradient, σ 1", pose_errors=30 * rises)) == []
    infinite = (np.full((6, 3), np.inf), np.ones((6, 4)))
    assert judge(make_run(recipe="gradient, σ 1", end=1.0)) == []
    assert (
        len(
            judge(
                make_run(recipe="gradient, σ 1")._replace(
                    trace=make_run().trace._replace(end=infinite)
                )
            )
        )
        == 1
    )


@pytest.fixture
def install(monkeypatch):
    """Puts these cases in place of a subject's."""

    def put(*cases, subject="loss"):
        monkeypatch.setattr(runner, "list_cases", lambda name: list(cases))
        monkeypatch.setattr(stability, "SUBJECTS", {subject: ""})

    return put


def run(folder, *flags):
    return stability.main([f"--out={folder}", *flags])


def test_the_command_writes_its_tables_and_ends_with_status_0(
    tmp_path, install, capsys
):
    install(make_case(lambda x: x * x * 1.0000001, limit="a square is smooth", terms=3))
    assert run(tmp_path, "--dtypes=float32,float16") == 0
    assert "All within tolerance" in capsys.readouterr().out
    report = (tmp_path / "stability.md").read_text()
    for text in ("2 of 2 rows are within", "jax 0", "seed 0", "a square is smooth"):
        assert text in report
    table = (tmp_path / "cases.md").read_text()
    assert table.count("| a square |") == 2 and "one product" in table
    data = json.loads((tmp_path / "stability.json").read_text())
    assert data["passes"] and not data["failures"]
    assert [row["dtype"] for row in data["rows"]] == ["float32", "float16"]
    assert data["seconds"]["loss"] > 0
    pictures = {path.name for path in tmp_path.glob("*.png")}
    assert pictures == {"stability_rows.png", "stability_sums.png"}
    assert all(f"({name})" in report for name in pictures)


def test_a_wrong_function_is_named_and_ends_with_status_1(tmp_path, install, capsys):
    install(make_case(lambda x: x * x + 1))
    assert run(tmp_path, "--dtypes=float32") == 1
    printed = capsys.readouterr().out
    assert "Outside tolerance: loss, a square, float32: the error of" in printed
    assert "0 of 1 rows" in (tmp_path / "stability.md").read_text()
    data = json.loads((tmp_path / "stability.json").read_text())
    assert not data["passes"] and len(data["failures"]) == 1


def test_an_infinite_error_is_null_in_json(tmp_path, install):
    install(make_case(lambda x: x / 0))
    assert run(tmp_path, "--dtypes=float32") == 1
    (row,) = json.loads((tmp_path / "stability.json").read_text())["rows"]
    assert row["value_error"] is None and row["is_finite"] is False


@pytest.mark.parametrize(
    "flag, known",
    [
        ("--subjects=rays", "rotation, camera"),
        ("--dtypes=float8", "float64, float32"),
        ("--subjects=", "rotation, camera"),
    ],
)
def test_an_unknown_name_is_refused_in_a_sentence(tmp_path, capsys, flag, known):
    assert run(tmp_path / "out", flag) == 2
    error = capsys.readouterr().err
    assert error.startswith("Error: ") and known in error
    assert "Traceback" not in error and not (tmp_path / "out").exists()


def test_a_folder_that_cannot_be_made_is_refused_in_a_sentence(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert run(tmp_path / "file", "--subjects=ray") == 1
    assert capsys.readouterr().err.startswith("Error: ")


def test_an_interrupted_run_keeps_the_subjects_that_are_done(
    tmp_path, monkeypatch, capsys
):
    def run_subject(name, **_):
        if name == "random":
            raise KeyboardInterrupt
        return [Row(name, "fine", "float32", 0.0, 1.0)], ""

    monkeypatch.setattr(runner, "run_subject", run_subject)
    assert run(tmp_path, "--subjects=random,sum") == 130
    assert "subjects are in" in capsys.readouterr().err
    (row,) = json.loads((tmp_path / "stability.json").read_text())["rows"]
    assert row["subject"] == "sum"


def test_the_quick_form_runs_fast_cases_in_float32_under_vmap(tmp_path, install):
    seen = []

    def square(x):
        seen.append(x.dtype.name)
        return x * x

    install(make_case(square), make_case(square, name="slow", is_slow=True))
    assert run(tmp_path, "--quick") == 0
    assert seen == ["float32"]  # traced once, which is for `vmap` alone
    (row,) = json.loads((tmp_path / "stability.json").read_text())["rows"]
    assert row["dtype"] == "float32" and row["case"] == "a square"
    assert "--quick" in (tmp_path / "stability.md").read_text()
    assert run(tmp_path, "--quick", "--dtypes=float16") == 0
    assert seen[1:] == ["float16"]
