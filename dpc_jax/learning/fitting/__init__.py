"""Fits of single objects: what one is asked for. Loads nothing: --help is quick."""

import dataclasses

LEARNED = ("rotations", "translations", "focal_lengths")  # of the cameras
POSES = ("auto", "given", "rough", "none")  # what a folder's poses are taken for


@dataclasses.dataclass(frozen=True)
class FitSettings:
    """How an object is fitted.

    Attributes:
      num_points: of the cloud in images of up to 128 pixels; four times as many in
        images twice as large.
      sides: of images and volume, coarse to fine; divisors of the images' side. Empty
        for all doublings from 64 to that side, 512 at most, or for half of a smaller
        side and all of it.
      steps: of each side; those beyond the last side are left out.
      sigma: of the points at the first and last step of each side, voxels of its grid.
      learning_rate: of the points, box diagonals; a tenth of it at the end of a side.
      repulsion_weight: of the points, which spreads them over the surface.
      pull_weight: of points outside of the silhouettes.
      depth_weight, color_weight: per pixel, beside silhouettes; used where depths or
        colours are given.
      searches: poses are the best of so many; near rough poses of half as many.
      elevations: lowest and highest of the cameras, degrees, of poses from nothing.
    """

    num_points: int = 4000
    sides: tuple[int, ...] = ()
    steps: tuple[int, ...] = (300, 150, 60, 40)
    sigma: tuple[float, float] = (2.0, 0.5)
    learning_rate: float = 0.01
    repulsion_weight: float = 0.006
    pull_weight: float = 1.0
    depth_weight: float = 1.0
    color_weight: float = 0.3
    searches: int = 4
    elevations: tuple[float, float] = (-20.0, 40.0)
