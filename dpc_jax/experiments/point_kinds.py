"""What runs of hand-tuned and of learned sizes of points differ in."""

import math
from typing import Any

# Hand-tuned sigma at the end of a run, a share of the volume's side, by number of
# points: the best on validation views of those tried (docs/baselines.md).
HAND_TUNED = {20: 0.055, 60: 0.035, 200: 0.03, 2000: 0.02}


def list_changes(point_size: str, num_points: int) -> dict[str, Any]:
    """Fields of the config, by section.name, for a run of known poses.

    All kinds learn the peak height of Eq. 3 and drop no points. Hand-tuned sizes go to
    that of the nearest number of points in `HAND_TUNED`.
    """
    changes = {
        "render.num_points": num_points,
        "render.scale_unit": "peak",
        "render.keep_start": 1.0,
        "render.keep_levels": 1,
        "network.point_size": point_size,
    }
    if not point_size:
        nearest = min(HAND_TUNED, key=lambda n: abs(math.log(n / num_points)))
        end = HAND_TUNED[nearest]
        changes |= {"render.sigma_start": max(0.05, end), "render.sigma_end": end}
    return changes
