"""The clouds that one can turn: their data, their place in the page, and the script.

The script is plotly's own, from its Python package, compressed to a third and unpacked
by the browser: the page needs no network and no file beside it.
"""

import base64
import functools
import gzip
import html
import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from dpc_jax.evaluation.chamfer import find_rows, spread_rows
from dpc_jax.reporting.examples import Example
from dpc_jax.reporting.web.markup import read_asset

FARTHEST = 0.1  # from the other cloud, box diagonals, that colours tell apart
_SHOWN = 2000  # points of a cloud; more make turning slow
_RADIUS = 0.012  # of 2000 points
_PLAIN, _TRUE = "rgb(74,134,188)", "rgb(160,168,176)"


def show_clouds(examples: Sequence[Example]) -> str:
    """The section in which the predicted and the true clouds are turned."""
    has_truth = any(example.surface is not None for example in examples)
    has_colors = any(example.colors is not None for example in examples)
    own = "Predicted colours" if has_colors else "One colour"
    options = "".join(
        f'<option value="{index}">{html.escape(example.title)}</option>'
        for index, example in enumerate(examples)
    )
    controls = f'<select id="choice" aria-label="Shown shape">{options}</select>'
    if has_truth:
        controls += (
            f'<button data-colors="own" aria-pressed="true">{own}</button>'
            '<button data-colors="error" aria-pressed="false">Error</button>'
        )
    controls += (
        '<span class="scale" id="scale" hidden>0 <i></i> '
        f"{100 * FARTHEST:.0f} and more (box diagonal × 100)</span>"
    )
    plots = [("predicted", "Predicted")] + [("true", "True")] * has_truth
    frames = "".join(
        f'<figure><div class="plot" id="{name}"><span class="say">The cloud is drawn '
        f"when it is looked at.</span></div><figcaption>{title}</figcaption></figure>"
        for name, title in plots
    )
    both = (
        " Both turn together. Errors are the distance of each point from the other "
        "shape: left what is predicted in the wrong place, right what is missing."
        if has_truth
        else ""
    )
    return (
        '<h2 id="turn">Shapes to turn</h2><p>Drag to turn, scroll to come nearer.'
        f"{both}</p>"
        f'<div class="controls">{controls}</div><div class="plots">{frames}</div>\n'
    )


def embed_scripts(examples: Sequence[Example]) -> str:
    """What stands at the end of the page: data, compressed library, and the script."""
    clouds = [describe_clouds(example) for example in examples]
    count = min(_SHOWN, max(len(example.points) for example in examples))
    radius = _RADIUS * np.clip(np.sqrt(2000 / max(count, 1)), 1.0, 2.5)
    sizes = {"radius": round(float(radius), 5), "farthest": FARTHEST}
    data = json.dumps(sizes | {"examples": clouds})
    return (
        f'<script type="application/json" id="clouds">{data}</script>\n'
        f'<script type="text/plain" id="plotly">{_pack_library()}</script>\n'
        f"<script>{read_asset('viewer.js')}</script>\n"
    )


def describe_clouds(example: Example) -> dict[str, Any]:
    """Both clouds of an example and their distances, as the script reads them."""
    count = len(example.points)
    rows = find_rows(count, min(_SHOWN, count))
    points, surface = np.asarray(example.points)[rows], example.surface
    predicted = {"points": _encode(points, "<f4"), "plain": _PLAIN}
    if example.colors is not None:
        colors = np.clip(255 * np.asarray(example.colors)[rows], 0, 255)
        predicted["colors"] = _encode(np.rint(colors), "u1")
    if surface is None:
        return {"predicted": predicted}
    true = spread_rows(surface, min(_SHOWN, len(surface)))
    errors = KDTree(surface).query(points)[0], KDTree(example.points).query(true)[0]
    predicted["errors"], missing = (_encode(away, "<f4") for away in errors)
    truth = {"points": _encode(true, "<f4"), "plain": _TRUE, "errors": missing}
    return {"predicted": predicted, "true": truth}


def _encode(array, dtype) -> str:
    return base64.b64encode(np.ascontiguousarray(array, dtype).tobytes()).decode()


@functools.cache
def _pack_library() -> str:
    """Plotly's script, gzip in base64: 2 MB instead of 5."""
    from plotly.offline import get_plotlyjs  # only pages with clouds need it

    packed = gzip.compress(get_plotlyjs().encode(), mtime=0)
    return base64.b64encode(packed).decode("ascii")
