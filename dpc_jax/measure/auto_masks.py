"""Automatic masks against the true ones: python -m dpc_jax.measure.auto_masks

Procedural cars, chairs and airplanes are rendered before plain backgrounds: of one
colour, noisy, lit from one side, with a cast shadow. It prints a Markdown table of
the intersection over union of the mask that `--mask=auto` finds with the true one.
"""

import argparse
import sys
import time
from collections.abc import Sequence

import numpy as np

from dpc_jax.data.sets.plain_background import find_object
from dpc_jax.data.viewpoints import look_at_rotation
from dpc_jax.data.views import build_scene, draw_lights, render_view
from dpc_jax.reporting.tables import format_table
from dpc_jax.shapes.procedural import CATEGORIES, make_shape

BACKGROUNDS = ("plain", "noisy", "gradient", "shadow", "all of these")
_GOOD = 0.9  # an overlap from which a mask is as good as one made by hand


def take_photograph(
    category: str, seed: int, background: str, *, side: int
) -> tuple[np.ndarray, np.ndarray]:
    """Image uint8 [side, side, 3] of an object, and its true mask [side, side].

    Args:
      background: of `BACKGROUNDS`. Its colour is any but one near the object's mean.
    """
    rng = np.random.default_rng([seed, BACKGROUNDS.index(background)])
    scene = build_scene(make_shape(category, seed))
    rotation = look_at_rotation(rng.uniform(0, 2 * np.pi), rng.uniform(-0.2, 0.6))
    lights = draw_lights(rng)
    view = render_view(scene, rotation, lights=lights, image_size=side, supersample=2)
    share = view.mask[..., None] / 255.0
    # On white: what the white adds at the edge is taken away again.
    colors = view.image.astype(np.float64) - 255.0 * (1.0 - share)
    mean = colors.sum((0, 1)) / share.sum()
    paint = rng.uniform(60, 250, 3)
    while np.linalg.norm(paint - mean) < 60:
        paint = rng.uniform(60, 250, 3)
    backdrop = np.broadcast_to(paint, (side, side, 3)) * np.ones((side, side, 1))
    is_all = background == BACKGROUNDS[-1]
    v, u = np.mgrid[-1 : 1 : side * 1j, -1 : 1 : side * 1j]
    if is_all or background == "gradient":
        turn = rng.uniform(0, 2 * np.pi)
        slope = np.cos(turn) * u + np.sin(turn) * v
        backdrop = backdrop * (1 + 0.25 * slope - 0.1 * (u**2 + v**2))[..., None]
    if is_all or background == "shadow":
        rows, columns = np.nonzero(view.mask > 127)
        low, middle = v[rows.max(), 0], u[0, columns].mean()
        wide = np.ptp(u[0, columns]) / 2
        depth = ((u - middle) / wide) ** 2 + ((v - low) / 0.1) ** 2
        backdrop = backdrop * (1 - 0.25 * np.exp(-depth))[..., None]
    image = colors + backdrop * (1.0 - share)
    if is_all or background == "noisy":
        image = image + rng.normal(0, 10, image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8), view.mask > 127


def measure_masks(
    background: str, *, objects: int, side: int
) -> tuple[np.ndarray, int, float]:
    """Overlaps [n] of found masks, how many were refused, and seconds for each."""
    overlaps, refused, seconds = [], 0, 0.0
    for category in CATEGORIES:
        for seed in range(objects):
            image, true = take_photograph(category, seed, background, side=side)
            started = time.perf_counter()
            try:
                mask = find_object(image) > 0.5
            except ValueError:
                refused += 1
                continue
            seconds += time.perf_counter() - started
            overlaps.append((mask & true).sum() / (mask | true).sum())
    return np.array(overlaps), refused, seconds / max(1, len(overlaps))


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse the command line, measure, print."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--objects", type=int, default=20, help="of each category")
    parser.add_argument("--side", type=int, default=512, help="of the images, pixels")
    flags = parser.parse_args(arguments)
    rows = []
    for background in BACKGROUNDS:
        found, refused, seconds = measure_masks(
            background, objects=max(1, flags.objects), side=max(16, flags.side)
        )
        rows.append(
            (
                background,
                f"{np.median(found):.3f}",
                f"{found.mean():.3f}",
                f"{found.min():.3f}",
                f"{np.mean(found >= _GOOD):.2f}",
                str(refused),
                f"{seconds:.2f}",
            )
        )
    heads = ("background", "median", "mean", "least", "≥ 0.9", "refused", "seconds")
    print(format_table(heads, rows, align="l" + "r" * 6), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
