"""Several short starts of a run, of which the best one goes on. Not in the paper.

Whether poses are found is decided in the first tenth of a run; where they are not, the
rest of it is lost. All starts see the same batches under the same schedules, so that
their losses can be compared.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import NamedTuple

from dpc_jax.config import Config, replace_fields
from dpc_jax.data import DataSet
from dpc_jax.learning.step import TrainState, init_state
from dpc_jax.learning.training import loop
from dpc_jax.learning.training.records import MetricLog
from dpc_jax.networks import ShapePoseNetwork

_SEEDS_APART = 1_000_003  # of the first parameters of one start and the next
_RECORDS = 10  # of each start at least; the later half of them is compared


class Start(NamedTuple):
    """The start that goes on.

    Attributes:
      state: after its steps.
      index: 0 for that of the run's own seed.
      losses: mean reprojection of each start over the later half of its steps.
      records: of its steps, for the log.
      seconds: that all of them took.
    """

    state: TrainState
    index: int
    losses: tuple[float, ...]
    records: list[dict]
    seconds: float


class _Records(MetricLog):
    """Keeps the records of a start in memory."""

    def __init__(self):
        super().__init__("")
        self.records: list[dict] = []

    def write(self, record: dict):
        self.records.append(record)


class _NoCheckpoints:
    """A start is made again where it was interrupted."""

    def save(self, state, *, seconds):
        """Keep nothing."""


def find_start(
    first: TrainState,
    dataset: DataSet,
    *,
    network: ShapePoseNetwork,
    config: Config,
    should_stop: Callable[[], bool] = lambda: False,
    tell: Callable[[str], None] = print,
    may_stop_waiting: bool = True,
) -> Start | None:
    """The best of `train.starts` states after `train.start_steps` steps each.

    Args:
      first: the state at step 0 of the run's own seed; its buffers are donated.
      dataset, network, config, should_stop, may_stop_waiting: as of `loop.train`.
      tell: shows a line.

    Returns:
      The start; None where it was asked to stop.

    Raises:
      NonFiniteError: as `loop.train`.
    """
    steps = config.train.start_steps
    every = min(config.log.every, max(1, steps // _RECORDS))
    trial = replace_fields(config, {"log": {"every": every, "checkpoint": 0}})
    best, losses, seconds = None, [], 0.0
    for index in range(config.train.starts):
        state = first
        if index:
            seed = config.seed + index * _SEEDS_APART
            state = init_state(network, dataclasses.replace(config, seed=seed))
        log = _Records()
        outcome = loop.train(
            state,
            dataset,
            network=network,
            config=trial,
            checkpoints=_NoCheckpoints(),
            log=log,
            should_stop=should_stop,
            may_stop_waiting=may_stop_waiting,
            seconds=seconds,
            title=f"Start {index + 1} of {config.train.starts}",
            until=steps,
        )
        if not outcome.is_finished:
            return None
        seconds = outcome.seconds
        late = [r for r in log.records if r["step"] > steps // 2]
        losses.append(math.fsum(r["reprojection"] for r in late) / len(late))
        if losses[-1] == min(losses):
            best = Start(outcome.state, index, (), log.records, 0.0)
    assert best is not None
    found = ", ".join(f"{loss:.2f}" for loss in losses)
    tell(f"Start {best.index + 1} goes on: reprojection losses were {found}.")
    return best._replace(losses=tuple(losses), seconds=seconds)
