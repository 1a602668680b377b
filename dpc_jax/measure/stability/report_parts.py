"""Parts of the stress report: what each is given, and what it hands back."""

import dataclasses
import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any


@dataclasses.dataclass(frozen=True)
class PartResult:
    """What a part of the report found.

    Attributes:
      markdown: its section, beginning with a heading of the second level; figures that
        it wrote into the folder are named relative to it.
      data: what JSON can hold, numbers in full; one that is not finite becomes null.
      passes: whether all of it is within its stated tolerances.
      failures: a sentence for each thing that is not.
    """

    markdown: str
    data: Any
    passes: bool
    failures: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class Order:
    """What a part is asked for.

    Attributes:
      out: the report's folder; it exists.
      seed: of all that is drawn.
      tell: shows a line of text to who waits.
      subjects: chapters of the catalogue to run; None for all.
      dtypes: dtypes of the catalogue to run; None for all that a case names.
    """

    out: Path
    seed: int = 0
    tell: Callable[[str], None] = print
    subjects: tuple[str, ...] | None = None
    dtypes: tuple[str, ...] | None = None


# Where the function `run_part(order) -> PartResult` of each part is; imported when it
# is asked for.
PARTS = {
    "cases": "dpc_jax.measure.stability.cases.catalogue",
    "ordinary": "dpc_jax.measure.stability.precision_report",
    "stiff": "dpc_jax.measure.stability.stiff.stiff_report",
    "random": "dpc_jax.measure.stability.draws.random_draws",
    "training": "dpc_jax.measure.stability.fast_training",
}


def run_part(name: str, order: Order) -> PartResult:
    """Run one of `PARTS`.

    Raises:
      ValueError: there is no such part.
    """
    if name not in PARTS:
        raise ValueError(
            f"parts must be some of {', '.join(PARTS)}, but {name!r} came; write for "
            "example --parts=cases."
        )
    return importlib.import_module(PARTS[name]).run_part(order)
