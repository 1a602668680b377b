"""Pose errors over the azimuth that an object is seen from."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dpc_jax.evaluation.failures import KINDS
from dpc_jax.evaluation.pose import ACCURACY_THRESHOLD_DEG
from dpc_jax.reporting import style

# Colour and sign of right views and of each kind of wrong ones (`failures.KINDS`).
_LOOKS = {
    -1: ("right", style.BLUE, "o"),
    0: (KINDS[0], style.RED, "s"),
    1: (KINDS[1], style.AMBER, "^"),
    2: (KINDS[2], style.GREEN, "D"),
    3: ("wrong otherwise", style.MUTED, "X"),
}


@dataclass(frozen=True)
class ViewPoses:
    """Where the views of a test set are taken from, and where the network says so."""

    true_deg: np.ndarray  # [n] azimuth, 0 to 360; 0 looks at the front
    predicted_deg: np.ndarray  # [n]
    errors_deg: np.ndarray  # [n] of the whole pose, 0 to 180
    kinds: np.ndarray  # [n] index into `failures.KINDS`; -1 of right views


def draw_azimuths(views: ViewPoses, path: str | os.PathLike) -> Path:
    """Pose error, and predicted azimuth, of each view over its true azimuth."""
    figure = style.make_figure(9.0, 4.2)
    left, right = style.make_panels(figure, 2)
    for kind, (label, color, marker) in _LOOKS.items():
        rows = views.kinds == kind
        if not rows.any():
            continue
        look = {"s": 14, "color": color, "marker": marker, "linewidths": 0}
        look |= {"alpha": 0.75, "clip_on": False, "zorder": 3}
        label = f"{label}: {int(rows.sum())}"
        left.scatter(views.true_deg[rows], views.errors_deg[rows], label=label, **look)
        right.scatter(views.true_deg[rows], views.predicted_deg[rows], **look)
    left.axhline(ACCURACY_THRESHOLD_DEG, color=style.INK, lw=1.0)
    for shift in (-180, 0, 180):
        line = {"color": style.INK if shift == 0 else style.MUTED, "lw": 0.9}
        ends = [0, 360], [shift, 360 + shift]
        right.plot(*ends, ls="-" if shift == 0 else ":", zorder=1, **line)
    for axes, title, y_label, top in (
        (left, "Pose error", "degrees", 180),
        (right, "Predicted azimuth", "degrees; dotted: half a turn off", 360),
    ):
        x_label = "true azimuth (degrees; 0 front, 90 left, 180 rear)"
        style.label_axes(axes, title=title, x_label=x_label, y_label=y_label)
        axes.set(xlim=(0, 360), xticks=range(0, 361, 90), ylim=(0, top))
        axes.set_yticks(range(0, top + 1, top // 6 if top == 180 else 90))
    look = {"frameon": False, "fontsize": 9, "ncols": len(_LOOKS)}
    figure.legend(loc="outside lower center", **look)
    return style.save_figure(figure, path)
