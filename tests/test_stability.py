"""Extreme cases of every public function, and the command that reports them."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dpc_jax import stability
from dpc_jax.measure.stability import DTYPES, SUBJECTS, descents, functions
from dpc_jax.measure.stability import random_draws as draws
from dpc_jax.measure.stability.random_draws import Range, Target
from dpc_jax.measure.stability.runner import Case, Row, compare, run_cases

# Sums, all draws and long descents are left to the slow test.
TABLES = [s for s in SUBJECTS if s not in ("sum", "random", "descent")]
# Compiled in a second or two each.
CHEAP = ("splat", "opacity", "mass_of_peak", "from_axis_angle", "student")


def make_case(function, **changes):
    """A case of x², for which `function` stands in."""
    about = ([0.5, -2.0, 3.0],), lambda x: x * x, 2, 2
    return dataclasses.replace(Case("a square", function, *about), **changes)


def run_made_up(case):
    with jax.debug_nans(False):
        (row,) = run_cases("made up", [case], quick=True)
    return row


def describe_failures(rows):
    assert rows
    return "\n".join(row.describe_failure() for row in rows if not row.passes)


@pytest.mark.parametrize("subject", TABLES)
def test_every_case_is_within_its_tolerance(subject):
    rows = stability.run_subject(subject, quick=True)
    assert not describe_failures(rows)
    assert len({row.case for row in rows}) == len(rows)


@pytest.mark.slow
@pytest.mark.parametrize("subject", SUBJECTS)
def test_every_case_is_within_its_tolerance_in_every_dtype_both_ways(subject):
    quick = subject == "random"  # in full it takes minutes
    assert not describe_failures(stability.run_subject(subject, quick=quick))


def test_stiff_descents_stay_finite_and_the_best_recipe_falls():
    rows = list(descents.run(quick=True))
    assert not describe_failures(rows)
    (held,) = [row.case for row in rows if row.errors[descents.LOSS][1] == 1]
    assert descents.BEST in held


@pytest.mark.parametrize(
    "function, fields, wrong",
    [
        (lambda x: 1.001 * x * x, {}, ["value error", "gradient error"]),
        (lambda x: x * x + 0.01 * (x - jnp.round(x * 2) / 2), {}, ["gradient error"]),
        # Without an oracle it is compared with itself in float64.
        (
            lambda x: jnp.sum(x * 0.1) + (0.01 if x.dtype == jnp.float32 else 0),
            *({"oracle": None}, ["value error"]),
        ),
        # A gradient alone that is infinite.
        (lambda x: x * x + 0 * jnp.sqrt(jnp.abs(x - 0.5)), {}, ["gradient error"]),
    ],
)
def test_a_wrong_function_fails(function, fields, wrong):
    row = run_made_up(make_case(function, **fields))
    assert not row.passes
    said = row.describe_failure()
    assert [name for name in row.errors if f"the {name} is" in said] == wrong
    if len(wrong) == 2:  # relative to the largest number
        for error, _ in row.errors.values():
            assert error == pytest.approx(1e-3, rel=1e-3)


@pytest.mark.parametrize("error", [np.nan, np.inf])
def test_what_is_not_finite_fails_even_where_it_only_has_to_be_finite(error):
    assert not Row("", "", "", {"loss": (error, np.inf)}).passes
    assert Row("", "", "", {"loss": (1e30, np.inf)}).passes
    case = make_case(lambda x: x + 1, is_half_checked=False)
    rows = list(run_cases("", [case]))
    assert [row.passes for row in rows] == [False, False, True, True]  # 16 bits


def test_another_shape_is_infinitely_wrong_and_a_lost_oracle_judges_nothing():
    assert compare([np.ones(2)], [np.ones(3)], "float32") == np.inf
    with pytest.raises(AssertionError, match="judges nothing"):
        compare([np.ones(2)], [np.full(2, np.inf)], "float32")


def test_random_draws_break_no_function():
    targets = [t for t in draws.TARGETS if any(c in t.name for c in CHEAP)]
    rows = [draws.run(target) for target in targets]
    assert len(rows) == len(targets) == len(CHEAP)
    assert not describe_failures(rows)


@pytest.mark.parametrize(
    "target, broken",
    [
        (Target("", lambda x: x * 2, (Range((2,)),)), "finite did not hold for ["),
        (
            Target("", jnp.sqrt, (Range((), 0, 1, (0, 1)),)),
            "gradient of input 0 did not hold for 0.0",
        ),
        (
            Target("", lambda x: x, (Range((3,), 0, 2, (0, 2)),), 0, 1),
            "its bounds did not hold",
        ),
    ],
)
def test_what_a_draw_breaks_is_named_with_the_draw(target, broken):
    with jax.debug_nans(False):
        row = draws.run(target)
    assert not row.passes and broken in row.describe_failure()


# The command.


@pytest.fixture
def install(monkeypatch):
    """Puts these cases in place of a subject's."""
    return lambda *cases: monkeypatch.setattr(functions, "CASES", {"loss": cases})


def run(folder, *flags):
    return stability.main([f"--out={folder}", "--subjects=loss", *flags])


def read_json(folder):
    return json.loads((folder / "stability.json").read_text())


def test_the_command_writes_its_tables_of_all_dtypes_and_ends_with_status_0(
    tmp_path, install, capsys
):
    install(make_case(lambda x: x * x))
    assert run(tmp_path) == 0
    assert "All within tolerance" in capsys.readouterr().out
    assert "4 of 4 rows are within" in (tmp_path / "stability.md").read_text()
    data = read_json(tmp_path)
    assert data["passes"] and not data["failures"] and data["seconds"]["loss"] > 0
    assert [row["dtype"] for row in data["rows"]] == list(DTYPES)


def test_a_wrong_function_is_named_and_ends_with_status_1(tmp_path, install, capsys):
    install(make_case(lambda x: x * x + 1), make_case(lambda x: x / 0, name="far"))
    assert run(tmp_path, "--quick") == 1
    printed = capsys.readouterr().out
    assert "Outside tolerance: loss, a square, float32: the value error" in printed
    assert "0 of 2 rows" in (tmp_path / "stability.md").read_text()
    data = read_json(tmp_path)
    assert not data["passes"] and len(data["failures"]) == 2
    assert data["rows"][1]["errors"]["value error"][0] is None


def test_an_interrupted_run_keeps_the_subjects_that_are_done(
    tmp_path, monkeypatch, capsys
):
    def run_subject(name, **_):
        if name == "random":
            raise KeyboardInterrupt
        return [Row(name, "fine", "float32")]

    monkeypatch.setattr(stability, "run_subject", run_subject)
    assert run(tmp_path, "--subjects=random,sum") == 130
    assert "subjects are in" in capsys.readouterr().err
    (row,) = read_json(tmp_path)["rows"]
    assert row["subject"] == "sum"
