"""The part of the report on training far too fast.

A run ends with finite numbers, or stops and names what broke.
"""

import contextlib
import dataclasses
import io
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

from dpc_jax.config import build_config, check, replace_fields
from dpc_jax.data import load_or_render
from dpc_jax.learning.step import init_state
from dpc_jax.learning.training import loop
from dpc_jax.learning.training.checkpoints import Checkpoints
from dpc_jax.learning.training.records import MetricLog, NonFiniteError
from dpc_jax.measure.stability.report_parts import (
    PartRequest,
    PartResult,
    start_section,
)
from dpc_jax.reporting.tables import format_table
from dpc_jax.run.setup import make_data_specs, make_network


@dataclasses.dataclass(frozen=True)
class Trial:
    """A run to try."""

    variant: str  # of the config, "" for the default
    factor: float  # times the config's learning rate
    steps: int  # of training


# The third must diverge: it shows that such a run stops.
TRIALS = (Trial("", 10, 2000), Trial("paper", 10, 2000), Trial("", 1e36, 2000))
QUICK_TRIALS = (Trial("", 10, 200),)


class Ending(NamedTuple):
    """How a run ended."""

    trial: Trial
    learning_rate: float  # the peak
    steps_done: int | None  # all steps; None if the run stopped
    seconds: float  # wall clock, compilation included
    # Means over the first and last interval of the log; None without one.
    first_loss: float | None
    last_loss: float | None
    largest_gradient: float | None  # norm, the largest of the log's means
    is_finite: bool  # the last state and every logged number; False if the run stopped
    error: str  # the message that the run stopped with, or ""


def run_part(
    request: PartRequest, *, trials: Sequence[Trial] | None = None
) -> PartResult:
    """Train small networks at ten times the learning rate; writes no file.

    The quick form takes 200 steps of the default; the full one 2,000 of it, of the
    paper's variant, and of a run that must stop.
    """
    endings = []
    trials = trials or (QUICK_TRIALS if request.quick else TRIALS)
    with tempfile.TemporaryDirectory() as folder:
        for place, trial in enumerate(trials):
            workdir = Path(folder, f"trial-{place}")
            endings.append(_train(trial, workdir, seed=request.seed))
            request.tell(f"training, {_name(trial)}: {_describe(endings[-1])}")
    failures = tuple(f for e in endings for f in judge(e))
    data = [dataclasses.asdict(e.trial) | e._asdict() for e in endings]
    for row in data:
        del row["trial"]
    return PartResult(_write_section(endings, failures), data, failures)


def _make_trial_config(trial, *, seed):
    """The default config in miniature: cars of 32 pixels, volumes of 8 to 16 cells."""
    full = build_config("car", trial.variant)
    coarse = dict(choice_grid=8, choice_points=50, choice_top=4)
    config = replace_fields(
        full,
        {
            "data": dict(models=12, image_size=32, surface_points=1000, views=5),
            "network": dict(channels=4, hidden=32, shape_hidden=32),
            # One stage: what is static changes the program, not what can break.
            "render": dict(grid=16, fine_grid=0, num_points=100)
            | dict(keep_start=1.0, keep_levels=1),
            "pose": dict(candidates=2) | (coarse if full.pose.choice_points else {}),
            "train": dict(
                steps=trial.steps,
                warmup_steps=min(full.train.warmup_steps, trial.steps // 10),
                learning_rate=full.train.learning_rate * trial.factor,
                models_per_batch=2,
                views_per_batch=2,
            ),
            "log": dict(every=max(1, trial.steps // 20), evaluate=0, checkpoint=0),
        },
    )
    return dataclasses.replace(config, seed=seed)


def _train(trial, workdir, *, seed):
    """Train one network with the loop that users train with."""
    config = _make_trial_config(trial, seed=seed)
    check(config)
    network = make_network(config)
    specs, cache = make_data_specs(config)["train"], workdir.parent / "data"
    dataset = load_or_render(specs, cache_dir=cache, processes=1, progress=False)
    start = time.perf_counter()
    state = init_state(network, config)
    workdir.mkdir()
    log = MetricLog(workdir / "metrics.jsonl")
    checkpoints = Checkpoints(workdir / "checkpoints")
    error, steps_done, is_finite = "", None, True
    try:
        # The report has a progress bar of its own.
        with contextlib.redirect_stdout(io.StringIO()):
            outcome = loop.train(
                state,
                dataset,
                network=network,
                config=config,
                checkpoints=checkpoints,
                log=log,
            )
        steps_done = int(outcome.state.step)
        leaves = jax.tree.leaves(jax.device_get(outcome.state))
        is_finite = all(bool(np.all(np.isfinite(leaf))) for leaf in leaves)
    except NonFiniteError as caught:
        error, is_finite = str(caught), False
    finally:
        checkpoints.close()
    records = log.read()
    is_finite &= all(np.all(np.isfinite(v)) for r in records for v in r.values())
    norms = [v for r in records for k, v in r.items() if k.startswith("gradient_norm")]
    losses = [r["loss"] for r in records if "loss" in r]
    return Ending(
        trial,
        learning_rate=config.train.learning_rate,
        steps_done=steps_done,
        seconds=time.perf_counter() - start,
        first_loss=losses[0] if losses else None,
        last_loss=losses[-1] if losses else None,
        largest_gradient=max(norms, default=None),
        is_finite=is_finite,
        error=error,
    )


def judge(ending: Ending) -> list[str]:
    """A sentence if a run neither ended finite nor said what broke and when."""
    trial = ending.trial
    label = f"training, {_name(trial)}"
    if ending.error:
        parts = ("loss became", "the loss grew", "gradient of the")
        has_name = any(part in ending.error for part in parts)
        is_complete = has_name and "at step" in ending.error
        sentence = f"{label}: it stopped without saying what broke: {ending.error}"
        return [] if is_complete else [sentence]
    if not ending.is_finite:
        return [f"{label}: it ended with numbers that are not finite, unnoticed."]
    if ending.steps_done != trial.steps:
        return [f"{label}: it ended after {ending.steps_done} of {trial.steps} steps."]
    return []


def _name(trial):
    return f"{trial.variant or 'default'}, learning rate x{trial.factor:g}"


def _describe(ending):
    if ending.error:
        return "stopped: " + ending.error.split(", but ")[-1].split(";")[0]
    return "finite to the end" if ending.is_finite else "not finite, unnoticed"


def _write_section(endings, failures):
    rows = []
    for e in endings:
        numbers = (e.first_loss, e.last_loss, e.largest_gradient)
        done = "–" if e.steps_done is None else e.steps_done
        rate = f"{e.learning_rate:.2g} (×{e.trial.factor:g})"
        begun = (rate, f"{done} of {e.trial.steps}", f"{e.seconds:.0f}")
        shown = ("–" if n is None else f"{n:.3g}" for n in numbers)
        rows.append((e.trial.variant or "default", *begun, *shown, _describe(e)))
    head = ("config", "learning rate", "steps", "seconds", "first loss", "last loss")
    lines = [
        *start_section("Training far too fast", failures),
        "The default config in miniature (12 cars of 32 pixels, a volume of 16³, 100 "
        "points, two heads), trained with the loop that users train with. A run must "
        "end with finite numbers, or stop and say what broke and at which step.",
        "",
        format_table((*head, "largest gradient norm", "ended"), rows),
    ]
    return "\n".join(lines)
