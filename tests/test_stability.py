"""Extreme cases of every public function, and the command that reports them."""

import json
import subprocess
import sys
import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tiny_runs import compiling_quickly

from dpc_jax import stability
from dpc_jax.measure.stability import report_parts
from dpc_jax.measure.stability.cases import case_report, catalogue
from dpc_jax.measure.stability.cases.case import DTYPES, Case, differentiate_oracle
from dpc_jax.measure.stability.cases.runner import compare, run_cases


def make_case(function, **changes):
    """A case of x², for which `function` stands in."""
    values = {
        "name": "a square",
        "subject": "made up",
        "function": function,
        "inputs": ([0.5, -2.0, 3.0],),
        "oracle": lambda x: x * x,
        "value_tolerance": 2,
        "gradient_tolerance": 2,
        "because": "one product",
    }
    return Case(**values | changes)


def install(monkeypatch, *cases):
    """Put these cases in place of the catalogue."""
    room = types.SimpleNamespace(SUBJECT="made up", list_cases=lambda: cases)
    monkeypatch.setattr(catalogue, "SUBJECTS", {"made up": room})
    monkeypatch.setattr(stability, "SUBJECTS", {"made up": room})


def run(folder, *flags):
    return stability.main([f"--out={folder}", "--parts=cases", *flags])


# An eighth of the programs of the command, which runs both ways in every dtype, and
# compiled with less effort, because that takes the time. The slow test runs all.
@pytest.mark.parametrize("subject", catalogue.SUBJECTS)
def test_every_case_is_within_its_tolerance(subject):
    is_numpy = subject == "evaluation"  # which is float64 alone
    with compiling_quickly():
        rows = catalogue.run_subjects(
            catalogue.list_cases((subject,)),
            dtypes=("float64" if is_numpy else "float32",),
            modes=("vmap",),
        )
    assert rows
    failures = [case_report.describe_failure(row) for row in rows if not row.passes]
    assert not failures, "\n".join(failures)


@pytest.mark.slow
@pytest.mark.parametrize("subject", catalogue.SUBJECTS)
def test_every_case_is_within_its_tolerance_in_every_dtype_both_ways(subject):
    rows = catalogue.run_subjects(catalogue.list_cases((subject,)))
    failures = [case_report.describe_failure(row) for row in rows if not row.passes]
    assert not failures, "\n".join(failures)


def test_every_case_says_where_its_tolerance_comes_from():
    for cases in catalogue.list_cases().values():
        for case in cases:
            assert case.because and case.value_tolerance >= 0


def test_a_right_function_passes_in_every_dtype():
    rows = list(run_cases([make_case(lambda x: x * x)]))
    assert [row.dtype for row in rows] == list(DTYPES)
    assert all(row.passes and row.is_finite for row in rows)


def test_a_function_that_is_wrong_by_a_thousandth_fails():
    (row,) = run_cases([make_case(lambda x: 1.001 * x * x)], dtypes=("float32",))
    assert not row.passes and row.is_finite
    # Relative to the largest, 9, and of the gradient to the largest slope.
    assert row.value_error == pytest.approx(1e-3, rel=1e-3)
    assert row.gradient_error == pytest.approx(1e-3, rel=1e-3)


def test_a_wrong_gradient_of_a_right_value_fails():
    wrong = make_case(lambda x: x * x + 0.01 * (x - jnp.round(x * 2) / 2))
    (row,) = run_cases([wrong], dtypes=("float32",))
    assert row.value_ratio <= 1
    assert not row.passes and row.gradient_ratio > 1


def test_nan_is_not_finite_and_fails_even_where_no_more_is_asked():
    case = make_case(lambda x: x * x + jnp.sqrt(-jnp.abs(x)), half="finite")
    with jax.debug_nans(False):
        rows = list(run_cases([case], dtypes=("float32", "bfloat16")))
    assert not any(row.is_finite or row.passes for row in rows)


def test_a_gradient_alone_that_is_infinite_fails():
    case = make_case(lambda x: x * x + 0 * jnp.sqrt(jnp.abs(x - 0.5)))
    with jax.debug_nans(False):
        (row,) = run_cases([case], dtypes=("float32",))
    assert row.value_ratio <= 1
    assert not row.is_finite and not row.passes


def test_an_oracle_that_is_not_finite_judges_nothing():
    case = make_case(
        lambda x: x, oracle=lambda x: np.full(3, np.inf), gradient_tolerance=None
    )
    with pytest.raises(FloatingPointError, match="judges nothing"):
        list(run_cases([case], dtypes=("float32",)))


def test_an_output_of_another_shape_is_infinitely_wrong():
    assert compare([np.ones(2)], [np.ones(3)], "float32") == np.inf


def test_derivatives_of_oracles_have_all_digits():
    def oracle(x):
        return np.exp(x) / (1 + x * x)

    (slope,) = differentiate_oracle(oracle, (np.array([0.7]),), [np.ones(1)])
    x = np.longdouble(0.7)
    expected = np.exp(x) * (1 - x) ** 2 / (1 + x * x) ** 2
    # Ten roundings of long double, of 1e-19 each; float64 where there is none.
    assert abs(slope[0] - expected) < 20 * np.finfo(np.longdouble).eps


def test_the_command_writes_its_tables_and_ends_with_status_0(
    tmp_path, monkeypatch, capsys
):
    install(monkeypatch, make_case(lambda x: x * x, limit="none: a square is smooth"))
    assert run(tmp_path, "--dtypes=float32,float16") == 0
    assert "All within tolerance" in capsys.readouterr().out
    report = (tmp_path / "stability.md").read_text()
    for text in ("within its stated tolerance", "jax 0", "seed 0", "a square is"):
        assert text in report
    table = (tmp_path / "cases.md").read_text()
    assert table.count("| a square |") == 2 and "one product" in table
    data = json.loads((tmp_path / "stability.json").read_text())
    assert data["passes"] and not data["failures"]
    assert [row["dtype"] for row in data["parts"]["cases"]] == ["float32", "float16"]
    assert data["seconds"]["cases"] > 0
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "cases.md",
        "stability.json",
        "stability.md",
    ]


def test_a_wrong_function_is_named_and_ends_with_status_1(
    tmp_path, monkeypatch, capsys
):
    install(monkeypatch, make_case(lambda x: x * x + 1))
    assert run(tmp_path, "--dtypes=float32") == 1
    printed = capsys.readouterr().out
    assert "Outside tolerance: made up, a square, float32: the error of" in printed
    report = (tmp_path / "stability.md").read_text()
    assert report.index("Outside tolerance: cases") < report.index("made up, a square")
    data = json.loads((tmp_path / "stability.json").read_text())
    assert not data["passes"] and len(data["failures"]) == 1


def test_an_infinite_error_is_null_in_json(tmp_path, monkeypatch, capsys):
    install(monkeypatch, make_case(lambda x: x / 0))
    assert run(tmp_path, "--dtypes=float32") == 1
    (row,) = json.loads((tmp_path / "stability.json").read_text())["parts"]["cases"]
    assert row["value_error"] is None and row["is_finite"] is False


@pytest.mark.parametrize(
    "flag, known",
    [
        ("--subjects=rays", "rotation, camera"),
        ("--dtypes=float8", "float64, float32"),
        ("--parts=everything", "cases, "),
        ("--parts=", "cases, "),
    ],
)
def test_an_unknown_name_is_refused_in_a_sentence(tmp_path, capsys, flag, known):
    assert stability.main([f"--out={tmp_path / 'out'}", flag]) == 2
    error = capsys.readouterr().err
    assert error.startswith("Error: ") and known in error
    assert "Traceback" not in error and not (tmp_path / "out").exists()


def test_a_folder_that_cannot_be_made_is_refused_in_a_sentence(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert run(tmp_path / "file", "--subjects=ray") == 1
    assert capsys.readouterr().err.startswith("Error: ")


def test_an_interrupted_run_keeps_the_parts_that_are_done(
    tmp_path, monkeypatch, capsys
):
    def run_part(name, request):
        if name == "random":
            raise KeyboardInterrupt
        return report_parts.PartResult(f"## {name}\n", {"part": name})

    monkeypatch.setattr(stability, "run_part", run_part)
    flags = [f"--out={tmp_path}", "--parts=random,ordinary"]
    assert stability.main(flags) == 130
    assert "parts are in" in capsys.readouterr().err
    data = json.loads((tmp_path / "stability.json").read_text())
    assert list(data["parts"]) == ["ordinary"]


def test_a_part_that_fails_is_named_on_top(tmp_path, monkeypatch, capsys):
    def run_part(name, request):
        failures = () if name == "cases" else ("too far.",)
        return report_parts.PartResult(f"## {name}\n", {}, failures)

    monkeypatch.setattr(stability, "run_part", run_part)
    assert stability.main([f"--out={tmp_path}", "--parts=cases,random"]) == 1
    assert "Outside tolerance: random." in (tmp_path / "stability.md").read_text()


def test_the_quick_form_runs_every_part_in_its_quick_form(tmp_path, monkeypatch):
    requests = {}

    def run_part(name, request):
        requests[name] = request
        return report_parts.PartResult(f"## {name}\n", {})

    monkeypatch.setattr(stability, "run_part", run_part)
    assert stability.main([f"--out={tmp_path}", "--quick"]) == 0
    assert list(requests) == list(report_parts.PARTS)
    assert all(request.quick for request in requests.values())
    assert requests["cases"].dtypes == ("float32",)
    assert "--quick" in (tmp_path / "stability.md").read_text()
    assert stability.main([f"--out={tmp_path}", "--quick", "--dtypes=float16"]) == 0
    assert requests["cases"].dtypes == ("float16",)
    assert stability.main([f"--out={tmp_path}"]) == 0
    assert not requests["cases"].quick and requests["cases"].dtypes is None


def test_the_quick_form_of_the_cases_runs_float32_under_vmap(
    tmp_path, monkeypatch, capsys
):
    seen = []

    def square(x):
        seen.append(x.dtype.name)
        return x * x

    install(monkeypatch, make_case(square))
    assert run(tmp_path, "--quick") == 0
    assert seen == ["float32"]  # traced once, which is for `vmap` alone
    data = json.loads((tmp_path / "stability.json").read_text())
    assert [row["dtype"] for row in data["parts"]["cases"]] == ["float32"]


def test_the_package_runs_without_hypothesis():
    code = (
        "import sys; sys.modules['hypothesis'] = None; "
        "import dpc_jax.stability; "
        "from dpc_jax.measure.stability.draws import random_draws; "
        "print(len(random_draws.list_targets()))"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True
    )
    assert int(result.stdout) > 0, result.stderr
