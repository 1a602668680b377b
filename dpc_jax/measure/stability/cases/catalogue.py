"""All cases by subject."""

import dataclasses
import importlib
import time
from collections.abc import Callable

from dpc_jax.measure.stability.cases import names as subjects_by_name
from dpc_jax.measure.stability.cases.case import DTYPES, Case
from dpc_jax.measure.stability.cases.runner import MODES, Row, run_cases
from dpc_jax.measure.stability.report_parts import check_names

# Modules of cases by the names of subjects on the command line.
SUBJECTS = {
    subject: importlib.import_module(f"dpc_jax.measure.stability.cases.{module}")
    for subject, module in subjects_by_name.SUBJECTS.items()
}


def list_cases(subjects: tuple[str, ...] | None = None) -> dict[str, list[Case]]:
    """Cases of some subjects, or of all; names are unique within one.

    Raises:
      ValueError: there is no such subject, or two cases have one name.
    """
    check_names("subjects", subjects, tuple(SUBJECTS))
    catalogue = {
        subject: [
            dataclasses.replace(case, subject=module.SUBJECT)
            for case in module.list_cases()
        ]
        for subject, module in SUBJECTS.items()
        if subjects is None or subject in subjects
    }
    for subject, cases in catalogue.items():
        names = [case.name for case in cases]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(
                f"Expected a name of its own for each case of {subject}, but "
                f"{', '.join(twice)} came twice; rename one."
            )
    return catalogue


def run_subjects(
    catalogue: dict[str, list[Case]],
    *,
    dtypes: tuple[str, ...] | None = None,
    modes: tuple[str, ...] = MODES,
    tell: Callable[[str], None] = print,
) -> list[Row]:
    """Rows of all cases (see `run_cases`), with a line of text for each subject.

    Raises:
      ValueError: there is no such dtype.
    """
    check_names("dtypes", dtypes, DTYPES)
    rows = []
    for subject, cases in catalogue.items():
        start = time.perf_counter()
        found = list(run_cases(cases, dtypes=dtypes, modes=modes))
        num_failed = sum(not row.passes for row in found)
        tell(
            f"cases, {subject}: {len(cases)} cases, {len(found)} rows, "
            f"{num_failed} outside tolerance, {time.perf_counter() - start:.0f} s"
        )
        rows += found
    return rows
