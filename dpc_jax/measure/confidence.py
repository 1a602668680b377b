"""Whether confidence ranks errors: python -m dpc_jax.measure.confidence WORKDIR...

On the test split of finished runs. It prints a Markdown table: pose accuracy among the
half and the four fifths of the views with the highest confidence, beside all; the rank
correlation of confidence with pose error and with Chamfer distance (-1: a perfect
ranking); and share and accuracy of the views of each level of trust.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dpc_jax.config import replace_fields
from dpc_jax.evaluation.confidence import LEVELS, Confidence, measure_confidence
from dpc_jax.evaluation.silhouettes import resize
from dpc_jax.learning.inference.evaluator import score
from dpc_jax.learning.inference.predictor import (
    arrange_views,
    make_predictor,
    predict_all,
)
from dpc_jax.reporting.tables import format_table
from dpc_jax.run.finished import load_split, read_run

COVERAGES = (0.5, 0.8, 1.0)  # shares of the views, the most trusted first


def judge_split(
    workdir: Path, cache_dir: str | None
) -> tuple[list[Confidence], np.ndarray, np.ndarray]:
    """Confidences of n test views, their pose errors [n] and Chamfer distances [n].

    Raises:
      ValueError: where the run is not finished, or has no ensemble.
    """
    run = read_run(workdir)
    if cache_dir:
        changed = replace_fields(run.config, {"data": {"cache_dir": cache_dir}})
        run = run._replace(config=changed)
    if run.config.pose.heads < 2:
        raise ValueError(
            f"Expected a run with an ensemble of pose heads in {workdir}, but it has "
            f"{run.config.pose.heads}; give another."
        )
    test = load_split(run, "test")
    predictor = make_predictor(run.network, run.config, keeps_candidates=True)
    found = predict_all(predictor, run.state, test)
    if found.cells is not None:
        from dpc_jax.learning.inference.volumes import add_points
        from dpc_jax.run.surfaces import read_threshold  # of voxel models alone

        found = add_points(found, read_threshold(workdir))
    result, _ = score(found, test, alignment=run.alignment, heads=run.config.pose.heads)
    assert result.pose_errors_deg is not None and result.chamfers is not None
    assert found.candidates is not None and found.probabilities is not None
    models, views = arrange_views(test)
    side = found.silhouettes.shape[-1]
    judged = [
        measure_confidence(
            found.poses[i],
            found.candidates[i],
            found.probabilities[i],
            found.silhouettes[i],
            resize(np.asarray(test.masks[models[i], views[i]]) / 255.0, side),
        )
        for i in np.ndindex(models.shape)
    ]
    chamfers = 100 * result.chamfers.sum(axis=-1)
    return judged, result.pose_errors_deg.reshape(-1), chamfers.reshape(-1)


def correlate_ranks(first: np.ndarray, second: np.ndarray) -> float:
    """Spearman's rank correlation of two arrays [n] without ties."""
    ranks = np.stack([np.argsort(np.argsort(values)) for values in (first, second)])
    first, second = ranks - ranks.mean(axis=1, keepdims=True)
    return float(first @ second / np.sqrt((first @ first) * (second @ second)))


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse the command line, measure, print."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("workdirs", nargs="+", type=Path, metavar="WORKDIR")
    parser.add_argument("--cache_dir", help="of the data; by default the run's")
    flags = parser.parse_args(arguments)
    rows = []
    for workdir in flags.workdirs:
        try:
            judged, errors, chamfers = judge_split(workdir, flags.cache_dir)
        except (ValueError, OSError) as error:
            print(f"Error: {error}", file=sys.stderr)
            return 1
        trust = np.array([one.confidence for one in judged])
        order, is_right = np.argsort(-trust), errors < 30
        row = [workdir.name]
        for share in COVERAGES:
            chosen = order[: max(1, round(share * len(order)))]
            row.append(f"{is_right[chosen].mean():.3f}")
        row += [f"{correlate_ranks(trust, v):.2f}" for v in (errors, chamfers)]
        levels = np.array([one.level for one in judged])
        for name, _ in LEVELS:
            among = levels == name
            right = f"{is_right[among].mean():.2f}" if among.any() else "–"
            row.append(f"{100 * among.mean():.0f} %: {right}")
        rows.append(row)
    heads = ["run", *(f"first {100 * share:.0f} %" for share in COVERAGES)]
    heads += ["with error", "with Chamfer", *(name for name, _ in LEVELS)]
    print(format_table(heads, rows, align="l" + "r" * (len(heads) - 1)), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
