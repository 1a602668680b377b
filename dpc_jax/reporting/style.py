"""One look for all figures, which are drawn without a display.

Figures are made by hand (no pyplot), so nothing global changes and threads may draw.
"""

import io
import os
from pathlib import Path
from typing import Any, Literal

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont, get_font
from matplotlib.rcsetup import cycler

from dpc_jax.files import write_bytes

INK, MUTED, GRID = "#22303c", "#8795a1", "#e6eaee"
# Colours of series, in the order in which they are given out.
BLUE, RED, GREEN, AMBER = "#2f7ebc", "#d1495b", "#3a9d6e", "#e0a030"
SERIES = (BLUE, RED, GREEN, AMBER, "#7b5ea7", "#5f6c77", "#56b4c9", "#8c5a3c")

# Other lines, once the colours are used up.
_LINES = cycler(linestyle=["-", "--", ":", "-."], marker=["o", "s", "^", "D"])
_LOOKS = list(_LINES * cycler(color=SERIES))


def pick_series(number: int) -> dict[str, str]:
    """How a line is drawn, for `Axes.plot`: no two of the first 32 look the same."""
    return _LOOKS[number % len(_LOOKS)]


def make_figure(width: float, height: float) -> Figure:
    """An empty figure of that size in inches, laid out by its content."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def label_axes(
    axes: Axes,
    *,
    title: str = "",
    x_label: str = "",
    y_label: str = "",
    grid: Literal["x", "y", "both"] = "y",
) -> None:
    """Title, labels, ticks and grid of a panel. An empty text leaves out its line."""
    axes.set_title(title, loc="left", fontsize=11, color=INK, fontweight="bold")
    axes.set_xlabel(x_label, fontsize=9, color=INK)
    axes.set_ylabel(y_label, fontsize=9, color=INK)
    axes.tick_params(labelsize=8, colors=INK, which="both")
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(axis=grid, color=GRID, lw=0.8)
    axes.set_axisbelow(True)


def add_legend(figure: Figure, **more: Any):
    """A legend below all panels, where no curve can run into it."""
    look = {"loc": "outside lower center", "frameon": False, "fontsize": 9}
    return figure.legend(**look | more)


def spell_name(name: str) -> str:
    """A user's name as a figure can have it: ? for each letter that the font lacks.

    A dollar sign stays one, and begins no formula.
    """
    known = get_font(findfont(FontProperties())).get_charmap()
    letters = (letter if ord(letter) in known else "?" for letter in name)
    return "".join(letters).replace("$", r"\$")


def save_figure(figure: Figure, path: str | os.PathLike) -> Path:
    """Write the figure as PNG or SVG, as its path ends, whole or not at all."""
    buffer = io.BytesIO()
    # Without version, date and chance in them, the same data give the same bytes.
    if Path(path).suffix == ".svg":
        with rc_context({"svg.fonttype": "none", "svg.hashsalt": "curves"}):
            figure.savefig(buffer, format="svg", metadata={"Date": None})
    else:
        figure.savefig(buffer, format="png", dpi=130, metadata={"Software": None})
    return write_bytes(path, buffer.getvalue())
