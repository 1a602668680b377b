"""Schedules over a run: point size, dropout, stages (§ Training details)."""

import bisect
from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp

from dpc_jax.config import Render

# Of point dropout: more of them are nearer to the line, but compile for longer.
_STAIRS = 8
# Share of a run from which winners are rendered in the fine grid. A later start leaves
# fewer steps for outlines; an earlier one costs time while shapes still form.
FINE_FROM = 0.6
# Voxels of a grid beyond 128³ from which on blocks can draw points (`project`).
_NARROW = 1.3
# Grids up to this side are drawn as whole volumes, which are as quick there.
_WHOLE_UP_TO = 128
# Share of a large volume's blocks that there is room for. Of 32,000 points of a surface
# in 256³, cars touch up to 11 %, chairs 13, airplanes 3 (six of each); `project` draws
# the whole volume for a cloud that touches more.
_ROOM = 1 / 8
# Shares of a run between which objects are turned to one frame by their points. Before,
# shapes have not formed; after, sharper ones of a kind that is right may look better
# turned round, and a few of them lead it astray (docs/log.md).
_FRAME_FROM, _FRAME_UNTIL = 0.2, 0.5
PULL_FROM = 0.5  # before it poses are too often wrong to pull points into silhouettes


def compute_sigma(step: chex.Numeric, render: Render, *, steps: int) -> jax.Array:
    """Standard deviation of a point in voxels of `render.grid`; linear in the step.

    The paper goes from 5 % to 0.3 % of the volume, at every resolution; its ablation
    has one of 1.6 voxels at 64 for the whole run, 2.5 % at both ends.
    """
    annealed = render.anneal_until * steps
    done = jnp.clip(jnp.asarray(step, jnp.float32) / annealed, 0, 1)
    share = render.sigma_start + done * (render.sigma_end - render.sigma_start)
    return share * render.grid


def count_kept_points(step: int, render: Render, *, steps: int) -> int:
    """How many points a step renders; linear in the step, in stairs.

    With a fine grid there is one stair, `keep_start` until that grid begins. A Python
    number: points left out are not rendered at all, and each stair is a program of its
    own.
    """
    if render.fine_grid:
        is_fine = step >= _find_fine_start(render) * steps
        share = render.keep_end if is_fine else render.keep_start
        return max(1, round(share * render.num_points))
    level = min(int(step * _STAIRS / (render.anneal_until * steps)), _STAIRS - 1)
    # The middle of the stair lies on the line; the last stair keeps the end value.
    done = 1.0 if level == _STAIRS - 1 else (level + 0.5) / _STAIRS
    share = render.keep_start + done * (render.keep_end - render.keep_start)
    return max(1, round(share * render.num_points))


def is_framing(step: chex.Numeric, *, steps: int, by_colors: bool) -> jax.Array:
    """Whether half turns are undone at a step; by colours to the end."""
    step = jnp.asarray(step)
    return (step >= _FRAME_FROM * steps) & (by_colors | (step < _FRAME_UNTIL * steps))


class Stage(NamedTuple):
    """What is static about a step; each stage is a program of its own.

    Attributes:
      kept_points: number of points rendered.
      grid: side of the volume that the winners are rendered in.
      max_blocks: room for blocks of a volume, see `project`; None in small grids.
    """

    kept_points: int
    grid: int
    max_blocks: int | None = None


def find_stage(step: int, render: Render, *, steps: int) -> Stage:
    """The stage that a step belongs to."""
    is_fine = render.fine_grid and step >= _find_fine_start(render) * steps
    grid = render.fine_grid if is_fine else render.grid
    return Stage(
        kept_points=count_kept_points(step, render, steps=steps),
        grid=grid,
        max_blocks=int(_ROOM * (grid / 8) ** 3) if grid > _WHOLE_UP_TO else None,
    )


def _find_fine_start(render: Render) -> float:
    """Share of a run from which winners are rendered in the fine grid."""
    start, end = render.sigma_start, render.sigma_end
    narrow = _NARROW / render.fine_grid
    if render.fine_grid <= _WHOLE_UP_TO or start <= narrow:
        return FINE_FROM
    # Where sigma does not fall so far, from the end of its schedule on.
    share = (start - narrow) / (start - end) if start > end else 1.0
    return max(FINE_FROM, min(share, 1.0) * render.anneal_until)


class Span(NamedTuple):
    """The steps of one stage, from `start` until just before `end`."""

    start: int
    end: int
    stage: Stage


def list_spans(render: Render, *, steps: int) -> tuple[Span, ...]:
    """The stages of a run in their order; no stage comes twice."""

    def find(step):
        return find_stage(step, render, steps=steps)

    spans, start = [], 0
    while start < steps:
        stage = find(start)
        rest = range(start, steps)
        later = bisect.bisect(rest, False, key=lambda s, own=stage: find(s) != own)
        spans.append(Span(start, start + later, stage))
        start += later
    return tuple(spans)
