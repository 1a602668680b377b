"""The other systems of Tables 1 and 2: what was followed here, and what differs.

docs/baselines.md has them in full.
"""

from typing import NamedTuple


class System(NamedTuple):
    """A system that the paper compares with.

    Attributes:
      source: who describes it.
      variant: its name in `VARIANTS`, by which its rows are found.
      followed: what is as in its authors' code or text.
      differs: what is not, and why.
    """

    source: str
    variant: str
    followed: str
    differs: str

    def describe(self) -> str:
        """One paragraph."""
        return f"{self.source} (`{self.variant}`). {self.followed} {self.differs}"


SHARED = (
    "The other systems have the data, the image encoder, the batches and the "
    "evaluation of the point clouds, so that a column compares shapes, projections and "
    "losses alone; their learning rates, but for MVC's, are tuned on validation shapes "
    "(docs/baselines.md). Voxel models are judged by 10,000 samples of their surface, "
    "at a threshold tuned on validation shapes; the mean shape of the training set is "
    "what a prediction scores that sees no image, but was told true surfaces. Time and "
    "memory of points and of voxels at 32, 64 and 128: docs/baselines.md, Costs by "
    "resolution."
)
SYSTEMS = (
    System(
        "DRC, Tulsiani et al. (2017)",
        "drc",
        "Followed: event costs of rays, 1 where a ray of the object escapes, 0.2 where "
        "one of the background is stopped.",
        "Differs: all pixels with samples at even depths, not 3000 random rays with "
        "exact traversal, because images are compared whole here; occupancies, not "
        "emptiness; its 0.2 was tuned by its authors on overlap, and not again here.",
    ),
    System(
        "PTN, Yan et al. (2016)",
        "ptn",
        "Followed: the maximum along each ray, squares of silhouettes, its decoder's "
        "doublings.",
        "Differs: masks of the images, not projections of the true voxels, which would "
        "be more supervision than any other row has; trained in one go, not with an "
        "encoder that learned to turn images before.",
    ),
    System(
        "Ours-V, the paper's voxel model",
        "ours_v",
        "Followed: losses and pose branches of the point clouds.",
        "Differs: its decoder is not published; this one doubles cells as PTN's does. "
        "Where poses are unknown, cells beyond the sphere that objects lie in are "
        "empty, without which chairs were not learned.",
    ),
    System(
        "EPCG, Lin et al. (2018)",
        "epcg",
        "Followed: maps of points at eight fixed views, compared with depth maps of "
        "these views; in a row of its own, then also drawn into cells of a fifth of a "
        "pixel and compared with masks and depths of the views of the data, which did "
        "not help on validation. By masks alone nothing teaches depths: there is a "
        "plane through the object's centre for each fixed view.",
        "Differs: the perspective camera and the views of the data, because those are "
        "what there is; depths count where the object is, so that a model cannot "
        "shrink its own supervision.",
    ),
    System(
        "MVC, Tulsiani et al. (2018)",
        "mvc",
        "Followed: a pose network of its own, eight heads of azimuth and elevation in "
        "a known range, one drawn by REINFORCE with a moving baseline, an adversarial "
        "prior of weight 0.1.",
        "Differs: a reward of the heads' entropy, without which all views soon draw "
        "one head in so few steps; 32 depths instead of 81, of which half lay outside "
        "the object; one optimiser, which for separate parameters is the same.",
    ),
)


def list_systems(variants: list[str]) -> list[System]:
    """Those that rows of these variants are of, in the order of the tables."""
    named = {name for variant in variants for name in variant.split(",")}
    return [system for system in SYSTEMS if system.variant in named]
