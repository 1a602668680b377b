"""The measurement of what a view costs, on small images."""

import numpy as np
import pytest

from dpc_jax.measure import view_rates
from dpc_jax.shapes import procedural


def test_divided_faces_cover_the_same_surface_in_the_same_colours():
    mesh = procedural.make_shape("chair", 3)
    count = 2 * len(mesh.faces) + 7
    divided = view_rates._divide_faces(mesh, faces=count)
    assert 0 <= len(divided.faces) - count <= 2
    assert divided.area == pytest.approx(mesh.area)
    options = dict(count=2, image_size=24, supersample=2)
    pairs = zip(
        view_rates._draw_views(mesh, **options),
        view_rates._draw_views(divided, **options),
        strict=True,
    )
    for first, second in pairs:
        # new corners are rounded to float32: rays within 1e-7 of a rim decide anew
        off = np.abs(first.image.astype(int) - second.image).max(axis=-1) > 1
        assert off.mean() < 0.01
        assert (first.mask != second.mask).mean() < 0.01


def test_more_rays_make_better_rims():
    mesh = procedural.make_shape("car", 0)
    errors = [
        view_rates._measure_rims(mesh, image_size=32, supersample=side)
        for side in (1, 2, 4, 16)
    ]
    assert errors == sorted(errors, reverse=True)
    # one ray decides for half of a pixel: 0.25 in the mean for a straight rim
    assert 0.15 < errors[0] < 0.35 and errors[-1] == 0


def test_the_command_prints_a_table_and_refuses_in_a_sentence(capsys):
    small = [
        "--image_size=8",
        "--faces",
        "50",
        "--rays",
        "2",
        "--views=1",
        "--rounds=2",
    ]
    assert view_rates.main(small) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2 + len(procedural.CATEGORIES)
    assert all(line.count("|") == 8 for line in lines)
    assert view_rates.main(["--image_size=0", *small[1:]]) == 1
    assert "must be at least 1" in capsys.readouterr().err
