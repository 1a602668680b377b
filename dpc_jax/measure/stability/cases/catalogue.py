"""All cases by subject, and the part of the report that runs them."""

import dataclasses
import time
from collections.abc import Callable
from typing import Any

from dpc_jax.files import write_text
from dpc_jax.measure.stability import case_tables
from dpc_jax.measure.stability.cases import (
    cameras,
    evaluation,
    gaussians,
    images,
    learning,
    losses,
    rays,
    rotations,
    volumes,
)
from dpc_jax.measure.stability.cases.case import DTYPES, Case
from dpc_jax.measure.stability.cases.runner import MODES, Row, run_cases
from dpc_jax.measure.stability.report_parts import Order, PartResult

# Subjects by the names that the command line knows.
SUBJECTS = {
    "rotation": rotations,
    "camera": cameras,
    "splat": volumes,
    "gaussian": gaussians,
    "ray": rays,
    "image": images,
    "loss": losses,
    "learning": learning,
    "evaluation": evaluation,
}


def list_cases(subjects: tuple[str, ...] | None = None) -> dict[str, list[Case]]:
    """Cases of each subject; names are unique within one.

    Args:
      subjects: of `SUBJECTS`; None for all.

    Raises:
      ValueError: there is no such subject, or two cases have one name.
    """
    check_names("subjects", subjects, tuple(SUBJECTS))
    catalogue = {}
    for subject in SUBJECTS:
        if subjects is not None and subject not in subjects:
            continue
        cases = SUBJECTS[subject].list_cases()
        names = [case.name for case in cases]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(
                f"expected each case of {subject} to have its own name, but "
                f"{', '.join(twice)} came twice; rename one."
            )
        catalogue[subject] = cases
    return catalogue


def check_names(what: str, names: tuple[str, ...] | None, known: tuple[str, ...]):
    """Refuse names that are not known, and none at all.

    Raises:
      ValueError: naming them and what is known.
    """
    unknown = [name for name in names or () if name not in known]
    if unknown or (names is not None and not names):
        raise ValueError(
            f"{what} must be some of {', '.join(known)}, but "
            f"{', '.join(unknown) or 'none'} came; write for example "
            f"--{what}={known[0]}."
        )


def run_subjects(
    catalogue: dict[str, list[Case]],
    *,
    dtypes: tuple[str, ...] | None = None,
    modes: tuple[str, ...] = MODES,
    tell: Callable[[str], None] = print,
    compiler_options: dict[str, Any] | None = None,
) -> list[Row]:
    """Rows of all cases, subject by subject; arguments as of `run_cases`.

    Raises:
      ValueError: there is no such dtype.
    """
    check_names("dtypes", dtypes, DTYPES)
    rows = []
    for subject, cases in catalogue.items():
        start = time.perf_counter()
        found = list(
            run_cases(
                cases, dtypes=dtypes, modes=modes, compiler_options=compiler_options
            )
        )
        num_failed = sum(not row.passes for row in found)
        tell(
            f"cases, {subject}: {len(cases)} cases, {len(found)} rows, "
            f"{num_failed} outside tolerance, {time.perf_counter() - start:.0f} s"
        )
        rows += found
    return rows


def run_part(order: Order) -> PartResult:
    """Run the catalogue, and write OUT/cases.md with a line for each case and dtype."""
    rows = run_subjects(
        list_cases(order.subjects), dtypes=order.dtypes, tell=order.tell
    )
    write_text(order.out / "cases.md", case_tables.write_table(rows))
    return PartResult(
        markdown=case_tables.write_section(rows, table="cases.md"),
        data=[dataclasses.asdict(row) for row in rows],
        passes=all(row.passes for row in rows),
        failures=tuple(case_tables.describe_failure(r) for r in rows if not r.passes),
    )
