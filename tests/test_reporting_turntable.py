"""Turntables: a picture that turns, the same from all around."""

import numpy as np
from PIL import Image

from dpc_jax.reporting.turntable import FRAMES, draw_turntable, write_turntable


def test_a_turntable_turns_once_and_plays_without_end(tmp_path):
    rng = np.random.default_rng(0)
    points = rng.normal(size=(60, 3)) * [0.2, 0.05, 0.05]
    for kind in ("gif", "webp"):
        path = tmp_path / f"cloud.{kind}"
        write_turntable(path, points)
        with Image.open(path) as image:
            assert image.n_frames == FRAMES and image.info["loop"] == 0
            first = np.asarray(image.convert("RGB"), float)
            image.seek(FRAMES // 4)
            quarter = np.asarray(image.convert("RGB"), float)
        # A rod looks wider from its side than from its end.
        widths = [
            np.ptp(np.nonzero((a < 200).any((0, 2)))[0]) for a in (first, quarter)
        ]
        assert abs(widths[0] - widths[1]) > 10


def test_colours_are_those_that_are_given():
    frames = draw_turntable(np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0]]), size=40)
    assert len(frames) == FRAMES
    middle = frames[0][20, 20].astype(int)
    assert middle[0] > 1.5 * middle[1:].max()  # what is far fades towards white
