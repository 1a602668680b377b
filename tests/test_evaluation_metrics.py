"""The registry of metrics: labels, roundings and the line printed during a run."""

import numpy as np
import pytest

from dpc_jax.evaluation.metrics import describe_metrics, format_metric, order_metrics

VALUES = {
    "chamfer": 3.314,
    "pose_accuracy": 0.8864,
    "silhouette_iou": 0.75,
    "pose_median_error_deg": 2.53,
    "train_seconds": 701.0,
}


def test_a_line_of_text_states_shares_from_0_to_1_and_the_others_as_tables_do():
    assert describe_metrics(VALUES) == (
        "pose accuracy 0.886, median error 2.5°, Chamfer 3.31, silhouette overlap 0.750"
    )
    few = describe_metrics(VALUES | {"pose_accuracy_stderr": 0.0123}, share_digits=2)
    assert few.startswith("pose accuracy 0.89 ± 0.01, ")
    assert describe_metrics({"chamfer": None}) == ""


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("pose_accuracy", np.float32(0.5), "50.0"),
        ("chamfer", 3.456, "3.46"),
        ("new_metric", 12345.678, "1.235e+04"),
        ("chamfer", float("nan"), "–"),
        ("device", "cpu", "cpu"),
    ],
)
def test_values_are_shown_in_their_unit_and_rounding(name, value, text):
    assert format_metric(name, value) == text


def test_known_metrics_come_in_the_registrys_order_and_the_others_after_them():
    names = ["zeta", "chamfer", "alpha", "pose_accuracy", "chamfer"]
    assert order_metrics(names) == ["pose_accuracy", "chamfer", "alpha", "zeta"]
