"""What an experiment of the paper is: a table or figure, and the rows that are trained.

A row says which config is trained, by its variant and what differs beside it. Rows of
several experiments that come to the same config are the same run.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

from dpc_jax.experiments.published import CATEGORIES, PublishedTable


@dataclasses.dataclass(frozen=True)
class Row:
    """A line of a table.

    Attributes:
      label: in our table.
      published: name of the paper's row in the experiment's table; "" for none.
      variant: the text after the colon of --config; None where nothing is trained.
      changes: "section.field": value, beside the variant.
      tag: names the changes in the folder of the run; "" without changes.
      budget: of the size; "" for that of the resolution.
      measure: "module:function" under `dpc_jax.experiments` that measures a row
        without variant on the data of a config; "" for none.
      is_long: whether a run takes over ten minutes at the size "cpu".
    """

    label: str
    published: str = ""
    variant: str | None = None
    changes: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    tag: str = ""
    budget: str = ""
    measure: str = ""
    is_long: bool = False


@dataclasses.dataclass(frozen=True)
class Experiment:
    """One table or figure of the paper.

    Attributes:
      name: of --experiment.
      title, question: of its section of the page.
      table: the paper's numbers.
      metrics: names of `metrics.json` that its table shows.
      rows: what is trained.
      categories: that it can be made of.
      analysis: "module:function" under `dpc_jax.experiments`, run on the finished
        workdirs; it gives metrics and figures. "" for none.
      reads: what the analysis is given: "all" of the workdirs together, or "each" by
        itself.
      picture: of each row's own report that the page shows; "" for none.
    """

    name: str
    title: str
    question: str
    table: PublishedTable
    metrics: tuple[str, ...]
    rows: tuple[Row, ...]
    categories: tuple[str, ...] = CATEGORIES
    analysis: str = ""
    reads: str = "each"
    picture: str = ""
