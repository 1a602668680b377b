"""Parts of the stress report: what each is asked for, and what it returns."""

import contextlib
import dataclasses
import importlib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any


@dataclasses.dataclass(frozen=True)
class PartRequest:
    """What a part is asked for."""

    out: Path  # the report's folder, for figures and tables; it exists
    quick: bool = False  # whether to run a small version, in half a minute
    seed: int = 0  # of all random numbers
    tell: Callable[[str], None] = print  # shows a line of text to whoever waits
    subjects: tuple[str, ...] | None = None  # chapters of the catalogue; None for all
    dtypes: tuple[str, ...] | None = None  # of the catalogue; None for all


@dataclasses.dataclass(frozen=True)
class PartResult:
    """What a part of the report found."""

    # Its section, which begins with a heading of the second level and names its figures
    # relative to the report's folder.
    markdown: str
    data: Any  # lists, dicts, texts and numbers, for JSON
    # A sentence for everything outside its stated tolerance
    failures: tuple[str, ...] = ()

    @property
    def passes(self) -> bool:
        """Whether everything is within its stated tolerance."""
        return not self.failures


# The module of each part. It has a function `run_part(request) -> PartResult` and is
# imported when the part runs.
PARTS = {
    "cases": "dpc_jax.measure.stability.cases.case_report",
    "ordinary": "dpc_jax.measure.stability.precision_report",
    "stiff": "dpc_jax.measure.stability.stiff.stiff_report",
    "random": "dpc_jax.measure.stability.draws.random_draws",
    "training": "dpc_jax.measure.stability.fast_training",
}


def start_section(title: str, failures: Iterable[str] = ()) -> list[str]:
    """The lines that a section begins with: its heading, then what failed, if any."""
    items = [f"- {failure}" for failure in failures]
    head = ["**Outside tolerance:**", "", *items, ""] if items else []
    return [f"## {title}", "", *head]


def run_part(name: str, request: PartRequest) -> PartResult:
    """Run one of `PARTS`.

    Raises:
      ValueError: there is no such part.
    """
    check_names("parts", (name,), tuple(PARTS))
    module = importlib.import_module(PARTS[name])
    with _compile_quickly() if request.quick else contextlib.nullcontext():
        return module.run_part(request)


@contextlib.contextmanager
def _compile_quickly():
    """Compile without XLA's optimisations, which take most of a quick part's time."""
    import jax  # heavy: flags are read first

    before = jax.config.read("jax_disable_most_optimizations")
    jax.config.update("jax_disable_most_optimizations", True)
    try:
        yield
    finally:
        jax.config.update("jax_disable_most_optimizations", before)


def check_names(
    flag: str, names: tuple[str, ...] | None, known: tuple[str, ...]
) -> None:
    """Refuse unknown names, and an empty list of names; None stands for all.

    Raises:
      ValueError: a name is not known, or there is none.
    """
    unknown = [name for name in names or () if name not in known]
    if unknown or names == ():
        raise ValueError(
            f"--{flag} must be some of {', '.join(known)}, but "
            f"{', '.join(unknown) or 'nothing'} came; write for example "
            f"--{flag}={known[0]}."
        )
