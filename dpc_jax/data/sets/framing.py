"""Framing a user's images: where the square of the data set's camera lies in each.

The camera of a data set looks at the middle of an object whose box diagonal is 1 from
a fixed distance. To match it, a square around the object is cut out of a photograph and
scaled so that the object fills a share of it; where position and lens of the camera are
known, the image is turned as if the camera had looked straight at the object.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from PIL import Image
from scipy import ndimage

from dpc_jax.data import viewpoints
from dpc_jax.data.sets.pose_files import Pose
from dpc_jax.data.spec import DataSpec

MOST_SAMPLES = 16  # per output pixel and axis, of blocks of the image's pixels


class Outline(NamedTuple):
    """What framing needs to know of a mask.

    shape: (height, width) of its image. low, high: [2] corners of its box in pixels,
    x before y, high exclusive. border: [2, n] centres (x, y) of the pixels at its rim.
    """

    shape: tuple[int, int]
    low: np.ndarray
    high: np.ndarray
    border: np.ndarray

    @property
    def middle(self) -> np.ndarray:
        """[2] middle (x, y) of the box, pixels."""
        return (self.low + self.high) / 2.0


class Frame(NamedTuple):
    """A square of the data set's camera in an image.

    homography: [3, 3], from (u, v, 1) of the frame, u and v in [-1/2, 1/2], to pixels
        of the image (corner at 0, 0).
    rotation: [3, 3], object to the camera of the frame, or None where poses are not
        known.
    """

    homography: np.ndarray
    rotation: np.ndarray | None


def trace_outline(mask: np.ndarray) -> Outline:
    """`Outline` of a boolean mask [height, width] that is not empty."""
    height, width = mask.shape
    box = np.array(Image.fromarray(mask).getbbox(), dtype=np.float64)
    inner = np.asarray(ndimage.binary_erosion(mask), dtype=bool)
    rim = np.nonzero(mask & ~inner)
    return Outline((height, width), box[:2], box[2:], np.stack(rim[::-1]) + 0.5)


def frame_views(
    outlines: Sequence[Outline], poses: Sequence[Pose] | None, spec: DataSpec
) -> list[Frame]:
    """Frames of all views of one object, as a specification asks for them.

    With positions and lenses the scale follows from them, and `spec.crop` does not
    matter.
    """
    if poses is not None and all(p.position is not None for p in poses):
        return _frame_by_geometry(outlines, poses, spec)
    rotations = [pose.rotation for pose in poses] if poses else [None] * len(outlines)
    if spec.crop == "none":
        middles = [np.array(outline.shape[::-1]) / 2.0 for outline in outlines]
        sides = [float(min(outline.shape)) for outline in outlines]
    else:
        middles = [outline.middle for outline in outlines]
        sides = [float((o.high - o.low).max()) / spec.fill for o in outlines]
        if spec.crop == "object":
            sides = [max(sides)] * len(sides)
    return [
        Frame(np.array([[s, 0, m[0]], [0, s, m[1]], [0, 0, 1]]), rotation)
        for s, m, rotation in zip(sides, middles, rotations, strict=True)
    ]


def _frame_by_geometry(outlines, poses, spec):
    """Frames of cameras whose place and lens are known.

    Each is turned to look at the point nearest to the lines through the middles of all
    masks, upright where the cameras tell what is up; the scale fits every view at its
    distance.
    """
    cameras = [
        (outline, pose, _read_lens(pose.lens, outline.shape))
        for pose, outline in zip(poses, outlines, strict=True)
    ]
    lines = []
    for outline, pose, lens in cameras:
        ray = np.linalg.solve(lens, [*outline.middle, 1.0])
        lines.append(pose.rotation.T @ (ray / np.linalg.norm(ray)))
    positions = np.array([pose.position for pose in poses])
    middle = _find_meeting_point(positions, np.array(lines))
    up = _find_up(np.array([pose.rotation for pose in poses]))

    turned, widths = [], []
    for outline, pose, lens in cameras:
        towards = pose.rotation @ (middle - pose.position)
        away = np.linalg.norm(towards)
        if not towards[2] > 1e-6 * max(away, 1e-30):
            raise ValueError(
                "Expected every camera to face the object, but one looks away from "
                "where the others see it; check the convention of the poses."
            )
        turn = _turn_to_axis(towards / away, pose.rotation @ up)
        rays = np.concatenate([outline.border, np.ones((1, outline.border.shape[1]))])
        seen = turn @ np.linalg.solve(lens, rays)
        # an object of size s at range r looks like one of size 1 at r / s
        widths.append(2.0 * np.abs(seen[:2] / seen[2]).max() * away / spec.fill)
        turned.append((lens @ turn.T, turn @ pose.rotation, away))
    size = max(widths) * spec.focal_length / spec.distance
    frames = []
    for homography, rotation, away in turned:
        side = size * spec.distance / (spec.focal_length * away)
        frames.append(Frame(homography @ np.diag([side, side, 1.0]), rotation))
    return frames


def _read_lens(lens, shape):
    """Matrix [3, 3] from camera rays to pixels, of an image of (height, width)."""
    lens, (height, width) = lens or {}, shape
    # images are often scaled after calibration
    wider, taller = width / lens.get("w", width), height / lens.get("h", height)
    if "fl_x" in lens:
        focal_x = lens["fl_x"] * wider
        focal_y = lens.get("fl_y", lens["fl_x"]) * taller
    elif "camera_angle_x" in lens:
        focal_x = focal_y = width / 2.0 / np.tan(lens["camera_angle_x"] / 2.0)
    else:
        raise ValueError(
            "Expected fl_x or camera_angle_x beside the frames, but found neither; add "
            "one."
        )
    center_x = lens["cx"] * wider if "cx" in lens else width / 2.0
    center_y = lens["cy"] * taller if "cy" in lens else height / 2.0
    return np.array([[focal_x, 0, center_x], [0, focal_y, center_y], [0, 0, 1.0]])


def _find_meeting_point(origins, directions):
    """Point [3] nearest to lines by least squares; the origin if they are parallel."""
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    total = across.sum(axis=0)
    if np.linalg.eigvalsh(total)[0] < 1e-3 * len(origins):
        return np.zeros(3)
    return np.linalg.solve(total, np.einsum("nij,nj->i", across, origins))


def _find_up(rotations):
    """The direction [3] that is up in the world; 0 where cameras do not tell it.

    It is at a right angle to the rows of images that are taken upright: to the first
    axes of rotations [n, 3, 3]. Cameras that roll much do not tell it, nor do those
    that all look along one plane, within 8 degrees.
    """
    right = rotations[:, 0]
    sizes, axes = np.linalg.eigh(right.T @ right / len(right))
    if sizes[0] > 0.1 * sizes[1] or sizes[1] < np.sin(np.deg2rad(8)) ** 2:
        return np.zeros(3)
    return axes[:, 0] * np.sign(-np.sum(rotations[:, 1], axis=0) @ axes[:, 0])


def _turn_to_axis(direction, up):
    """The rotation [3, 3] that takes a unit vector to (0, 0, 1), and keeps `up` above.

    Where that is 0, or the direction is along it, what is up for the camera stays so.
    """
    right = np.cross(direction, up)
    if np.linalg.norm(right) < 0.1:
        right = np.cross(direction, [0.0, -1.0, 0.0])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(direction, right), direction])


def cut_frames(
    views: Iterable[tuple[np.ndarray, np.ndarray]],
    frames: Sequence[Frame],
    spec: DataSpec,
) -> dict[str, np.ndarray]:
    """Images, masks and, where they are known, quaternions of an object's views.

    views: (image, mask) of each, as of `_cut_frame`, one in memory at a time.
    """
    cut = [
        _cut_frame(image, mask, frame, image_size=spec.image_size)
        for (image, mask), frame in zip(views, frames, strict=True)
    ]
    pictures, masks = map(np.stack, zip(*cut, strict=True))
    arrays = {"images": pictures, "masks": masks}
    if frames[0].rotation is not None:
        rotations = np.array([frame.rotation for frame in frames])
        quaternions = viewpoints.matrix_to_quaternion(rotations)
        arrays["quaternions"] = quaternions.astype(np.float32)
    return arrays


def _cut_frame(image, mask, frame, *, image_size):
    """Image and mask as the camera of a frame sees them, by supersampling.

    From uint8 [height, width, 3] and coverage float32 [height, width] of 0 to 1 to
    uint8 [S, S, 3] on white and uint8 [S, S]. What lies beyond the image is empty.
    """
    corners = np.array([[-0.5, 0.5, 0.5, -0.5], [-0.5, -0.5, 0.5, 0.5], [1] * 4])
    outline = frame.homography @ corners
    outline = outline[:2] / outline[2]
    low = np.floor(outline.min(axis=1)).astype(int) - 2
    high = np.ceil(outline.max(axis=1)).astype(int) + 2
    # at least a pixel, even where the frame lies beside the image
    low = np.clip(low, 0, np.array(image.shape[1::-1]) - 1)
    high = np.maximum(np.minimum(high, image.shape[1::-1]), low + 1)
    region = np.s_[low[1] : high[1], low[0] : high[0]]
    wide = np.linalg.norm(outline[:, 1] - outline[:, 0]) / image_size
    block = max(1, int(wide / MOST_SAMPLES * 2))
    side = image_size * int(np.clip(np.ceil(wide / block), 2, MOST_SAMPLES))
    picture = Image.fromarray(image[region])
    picture.putalpha(Image.fromarray(np.rint(255 * mask[region]).astype(np.uint8)))
    # with colours times coverage, so that what is not the object does not mix in
    picture = picture.convert("RGBa").reduce(block)
    from_samples = [[1 / side, 0, -0.5], [0, 1 / side, -0.5], [0, 0, 1]]
    to_blocks = [[1, 0, -low[0]], [0, 1, -low[1]], [0, 0, block]]
    places = to_blocks @ frame.homography @ from_samples
    numbers = (places / places[2, 2]).ravel()[:8].tolist()
    way = Image.Transform.PERSPECTIVE
    picture = picture.transform((side, side), way, numbers, Image.Resampling.BILINEAR)
    layers = np.asarray(picture.reduce(side // image_size))
    colors, coverage = layers[..., :3], layers[..., 3]
    on_white = np.minimum(colors + (255 - coverage[..., None].astype(int)), 255)
    return on_white.astype(np.uint8), coverage
