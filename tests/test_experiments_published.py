"""The paper's numbers agree with the sums that the paper prints."""

import pytest

from dpc_jax.experiments.catalogue import EXPERIMENTS
from dpc_jax.experiments.published import ABLATION


def test_precision_and_coverage_of_the_ablation_add_up_to_chamfer():
    assert len(ABLATION.rows) == 7
    for values in (row["chair"] for row in ABLATION.rows.values()):
        total = values["precision"] + values["coverage"]
        assert values["chamfer"] == pytest.approx(total, abs=0.011)


def test_rows_name_rows_that_the_paper_has():
    for experiment in EXPERIMENTS:
        named = {row.published for row in experiment.rows if row.published}
        assert named == set(experiment.table.rows), experiment.name
