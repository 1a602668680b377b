"""What a run learns and how: one frozen record, made once from the config."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class Settings:
    """Everything that the training step depends on; all static.

    Attributes:
      steps: training steps in all; the schedules end there.
      models_per_batch, views_per_batch: objects in a batch and views of each.
      grid: side of the volume and of the silhouettes compared, in voxels.
      fine_grid, fine_from: a finer grid for the winners' renders, from this share of
        the run on; 0 for none.
      num_points: N.
      num_candidates: K pose heads; 0 where poses are known.
      flips: also try every head turned by 180° about each principal axis.
      selects: whether the student selects a candidate or regresses a pose.
      choice_grid, choice_points: volume and largest number of points that candidates
        are first compared with; `grid` and all points where 0.
      choice_top: how many of them are then compared exactly; 0 for none.
      student_weight: of the student's loss, per pixel of the silhouette loss.
      sigma_start, sigma_end: standard deviation of a point over the run, as a share of
        the volume's side.
      anneal_until: share of the run after which point size and dropout stay at their
        end values.
      keep_start, keep_end: share of the points rendered over the run.
      keep_levels: number of different shares; each is compiled once.
      scale_unit: what the learned scale in (0, 1) multiplies: "peak", a density of one
        at the point, or "mass", one voxel.
      learning_rate, warmup_steps, final_rate: peak rate, steps of linear warm-up, and
        share of the peak that a cosine decay ends at; 1 keeps it constant.
      weight_decay: of decoupled weight decay (AdamW); 0 is Adam.
      repulsion_weight: of the points' repulsion energy; 0 for none.
      repulsion_points: how many points of a cloud repel each other in a step.
      containment_weight: of points beyond the sphere that holds every object.
      color_weight: of the colour loss, per pixel; 0 learns no colour.
      focal_length, distance: of the camera.
      renders_at_once: how many views are rendered side by side; 0 for all (GPU).
      seed: of parameters, batches and dropout.
    """

    steps: int
    models_per_batch: int
    views_per_batch: int
    grid: int
    fine_grid: int
    fine_from: float
    num_points: int
    num_candidates: int
    flips: bool
    selects: bool
    choice_grid: int
    choice_points: int
    choice_top: int
    student_weight: float
    sigma_start: float
    sigma_end: float
    anneal_until: float
    keep_start: float
    keep_end: float
    keep_levels: int
    scale_unit: str
    learning_rate: float
    warmup_steps: int
    final_rate: float
    weight_decay: float
    repulsion_weight: float
    repulsion_points: int
    containment_weight: float
    color_weight: float
    focal_length: float
    distance: float
    renders_at_once: int
    seed: int
