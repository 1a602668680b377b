"""Contact sheets: pictures in a grid, with a line of text under each."""

from collections.abc import Iterable, Sequence

import numpy as np
import trimesh
from PIL import Image, ImageDraw

from dpc_jax.data import viewpoints, views

VIEWS = ((35, 20), (90, 5), (180, 10), (-60, 45))  # azimuth, elevation, degrees
LINE = 12  # pixels of a line of text


def draw_models(
    meshes: Iterable[trimesh.Trimesh], texts: Sequence[str], *, size: int
) -> Image.Image:
    """Sheet of normalised models, three in a row, with a line of text under each.

    Each is seen from four sides: half front, left, rear, above the right.
    """
    lights = views.Lights(
        np.array([[0.3, 0.4, 0.86], [0.6, -0.7, 0.4]]), np.array([0.45, 0.2]), 0.35
    )
    strips = []
    for mesh in meshes:
        scene = views.build_scene(mesh)
        pictures = [
            views.render_view(
                scene,
                viewpoints.look_at_rotation(np.deg2rad(azimuth), np.deg2rad(elevation)),
                lights=lights,
                image_size=size,
                supersample=3,
            ).image
            for azimuth, elevation in VIEWS
        ]
        strips.append(np.concatenate(pictures, axis=1))
    return arrange(strips, texts, columns=3)


def arrange(
    pictures: Sequence[np.ndarray], texts: Sequence[str], *, columns: int
) -> Image.Image:
    """Pictures uint8 [H, W, 3] of one size in a grid, a line of text under each."""
    height, width = pictures[0].shape[:2]
    rows = -(-len(pictures) // columns)
    gap = 6
    sheet = Image.new(
        "RGB", (columns * (width + gap), rows * (height + LINE + gap)), "white"
    )
    pen = ImageDraw.Draw(sheet)
    for i, (picture, text) in enumerate(zip(pictures, texts, strict=True)):
        x, y = i % columns * (width + gap), i // columns * (height + LINE + gap)
        sheet.paste(Image.fromarray(picture), (x, y))
        pen.text((x + 2, y + height), text[: width // 6], fill="black")
    return sheet
