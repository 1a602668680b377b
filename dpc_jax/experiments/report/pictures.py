"""Pictures of runs on the page: test views of the first finished run of a row."""

import io
from pathlib import Path

from PIL import Image

from dpc_jax.experiments.declarations import Experiment
from dpc_jax.experiments.report.figures import Drawn
from dpc_jax.experiments.results import Results
from dpc_jax.files import write_bytes

_WIDTH = 900  # pixels, of a page's column
_COLORS = 256  # of a palette: a third of the bytes


def copy_pictures(
    results: Results, experiment: Experiment, folder: Path
) -> list[Drawn]:
    """Small copies of the pictures that the runs' own reports have, with captions.

    Of the first category that has any: a picture per row, of its first seed.
    """
    for category in results.list_categories(experiment):
        drawn = []
        for row in experiment.rows:
            for outcome in results.list_outcomes(experiment, row, category)[:1]:
                path = outcome.workdir / "report" / experiment.picture
                if outcome.metrics is not None and path.is_file():
                    copy = folder / f"{outcome.run.name}_{path.name}"
                    text = f"{row.label}: test views of the {category}s, first seed."
                    if _is_older(copy, path):
                        _copy_small(path, copy)
                    drawn.append((copy, text))
        if drawn:
            return drawn
    return []


def _is_older(copy: Path, path: Path) -> bool:
    """Whether there is no copy of a picture as it is now; one takes a second."""
    return not copy.exists() or copy.stat().st_mtime_ns < path.stat().st_mtime_ns


def _copy_small(path: Path, copy: Path) -> Path:
    """The picture with few colours, at most a column wide.

    Rare colours keep theirs: a scale of colours, and what is drawn in it, would be
    misread where the palette is chosen by how many pixels have a colour.
    """
    with Image.open(path) as opened:
        image = opened.convert("RGB")
    if image.width > _WIDTH:
        height = round(image.height * _WIDTH / image.width)
        image = image.resize((_WIDTH, height), Image.Resampling.LANCZOS)
    buffer = io.BytesIO()
    method = Image.Quantize.MAXCOVERAGE
    few = image.quantize(_COLORS, method=method, kmeans=3)
    few.save(buffer, format="PNG", optimize=True)
    return write_bytes(copy, buffer.getvalue())
