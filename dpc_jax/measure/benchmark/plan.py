"""What the benchmark measures, and at which sizes."""

import dataclasses

PARTS = ("speed", "sizes", "error")
SEED = 0  # of all that is drawn


@dataclasses.dataclass(frozen=True)
class Case:
    """One workload: `batch` clouds of `points` points on a `side`³ grid."""

    batch: int
    points: int
    side: int
    sigma: float

    def __str__(self):
        return f"B={self.batch}, N={self.points}, D={self.side}, σ={self.sigma:g}"


@dataclasses.dataclass(frozen=True)
class Plan:
    """Sizes of one run of the benchmark."""

    rounds: int  # of each measurement; medians are reported
    cases: tuple[Case, ...]  # of the speed table
    # Surfaces in the whole volume and in blocks, and which signals are rendered.
    sizes: tuple[tuple[Case, tuple[str, ...]], ...]
    scene_points: int  # of the dense scenes
    sparse_points: int  # of the sparse one
    sigmas: tuple[float, ...]  # voxels of a grid with `base_side` cells a side
    base_side: int
    sides: tuple[int, ...]  # of cubic grids
    reference_side: int  # of the float64 reference
    budget_seconds: float  # after so much time a setting gets no further round


FULL = Plan(
    rounds=7,
    cases=(Case(16, 8000, 64, 3), Case(16, 2000, 32, 1.6), Case(4, 16000, 128, 3)),
    sizes=(
        (Case(1, 4000, 64, 0.5), ("silhouette",)),
        (Case(1, 16_000, 128, 0.8), ("silhouette",)),
        (Case(1, 16_000, 128, 0.8), ("silhouette", "depth", "color")),
        (Case(1, 64_000, 256, 0.6), ("silhouette",)),
        (Case(1, 250_000, 512, 0.6), ("silhouette",)),
        (Case(1, 1_000_000, 1024, 0.6), ("silhouette",)),
    ),
    scene_points=8000,
    sparse_points=400,
    sigmas=(0.3, 0.6, 1.2, 2.5, 5.0),
    base_side=64,
    sides=(32, 64, 128),
    reference_side=192,  # a multiple of 32 and 64
    budget_seconds=1.5,
)

# Sizes that share programs: nearly all of its time goes into compiling them.
QUICK = Plan(
    rounds=3,
    cases=(Case(2, 500, 16, 1.5),),
    sizes=((Case(1, 500, 32, 0.6), ("silhouette",)),),
    scene_points=500,
    sparse_points=500,
    sigmas=(0.5, 2.0),
    base_side=16,
    sides=(16,),
    reference_side=32,
    budget_seconds=0.2,
)
