"""Small sets on disk in the forms that users have, drawn without the package."""

import json

import numpy as np
import trimesh
from PIL import Image
from scipy.io import savemat
from scipy.spatial.transform import Rotation

FOCAL_LENGTH, DISTANCE = 1.875, 2.0  # of the camera
# Centres and radii of three balls, an object without symmetry; z up, x front.
BALLS = np.array(
    [[0.25, 0.0, -0.05, 0.12], [-0.2, 0.1, 0.0, 0.16], [0, -0.1, 0.2, 0.1]]
)
COLORS = np.array([[200, 40, 40], [40, 160, 40], [40, 40, 200]])


def look_at(position, target=(0, 0, 0)):
    """Rows: right, down and forward of an upright camera, z up."""
    forward = np.subtract(target, position)
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def draw_balls(rotation, position, lens, shape, balls=BALLS):
    """(RGBA bytes [h, w, 4], depth [h, w], inf where empty) by a ray per pixel."""
    rows, columns = np.mgrid[: shape[0], : shape[1]] + 0.5
    rays = np.stack([columns, rows, np.ones(shape)], -1) @ np.linalg.inv(lens).T
    depth, color = np.full(shape, np.inf), np.full((*shape, 3), 90)  # a grey room
    for ball, paint in zip(balls, COLORS, strict=True):
        center = rotation @ (ball[:3] - position)
        a, b = (rays**2).sum(-1), rays @ center
        root = b**2 - a * (center @ center - ball[3] ** 2)
        near = np.where(root > 0, (b - np.sqrt(np.maximum(root, 0))) / a, np.inf)
        color[near < depth] = paint
        depth = np.minimum(depth, near)
    alpha = np.where(np.isfinite(depth), 255, 0)[..., None]
    return np.concatenate([color, alpha], -1).astype(np.uint8), depth


def sample_balls(balls=BALLS):
    """Points [900, 3] on the balls."""
    rng = np.random.default_rng(0)
    unit = rng.normal(size=(len(balls), 300, 3))
    unit /= np.linalg.norm(unit, axis=-1, keepdims=True)
    return (balls[:, None, :3] + balls[:, None, 3:] * unit).reshape(-1, 3)


def rotate(quaternion):
    """Rotation matrix of a quaternion wxyz, by scipy."""
    quaternion = np.asarray(quaternion, np.float64)
    return Rotation.from_quat(quaternion, scalar_first=True).as_matrix()


def project_points(points, quaternion, size, *, distance=DISTANCE):
    """Rows and columns, in pixels from the corner, and depths of points in a pose."""
    x, y, z = rotate(quaternion) @ np.asarray(points, np.float64).T
    z += distance
    return *(size * (FOCAL_LENGTH * a / z + 0.5) for a in (y, x)), z


def share_inside(points, quaternion, mask):
    """Share of points that the stored pose puts where the stored mask is covered."""
    rows, columns, _ = project_points(points, quaternion, size := len(mask))
    rows, columns = np.floor([rows, columns]).astype(int)
    inside = (rows >= 0) & (rows < size) & (columns >= 0) & (columns < size)
    return (mask[rows[inside], columns[inside]] > 0).sum() / len(points)


def write_boxes(folder, count):
    """So many boxes of different length as mesh files; the folder."""
    folder.mkdir(exist_ok=True)
    for i in range(count):
        box = trimesh.creation.box(extents=[2 + 0.1 * i, 1, 1])
        box.export(folder / f"box{i}.ply")
    return folder


def write_renders(folder, models, *, truth=True):
    """Published renders of the balls, each model a little larger: DIR/renders, DIR/gt.

    A model has three views of 112 pixels. The world of the cameras is z up; the ground
    truth's axes are y up with the same x.
    """
    synset = "02958343"
    rng = np.random.default_rng(0)
    lens = np.array([[210.0, 0, 56], [0, 210, 56], [0, 0, 1]])
    for number, model in enumerate(models):
        balls = BALLS * (0.9 + 0.1 * number / max(1, len(models) - 1))
        place = folder / "renders" / synset / model
        place.mkdir(parents=True)
        for view in range(3):
            azimuth, elevation = rng.uniform(0, 2 * np.pi), rng.uniform(-0.3, 0.7)
            flat = 2 * np.cos(elevation)
            position = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth),
                                 2 * np.sin(elevation)])  # fmt: skip
            rotation = look_at(position)
            rgba, depth = draw_balls(rotation, position, lens, (112, 112), balls)
            Image.fromarray(rgba).save(place / f"render_{view}.png")
            raw = np.minimum(depth, 10.0) * (65535 / 10)
            Image.fromarray(raw.astype(np.uint16)).save(place / f"depth_{view}.png")
            extrinsic = np.eye(4)
            extrinsic[:3, :3], extrinsic[:3, 3] = rotation, -rotation @ position
            savemat(
                place / f"camera_{view}.mat",
                {"extrinsic": extrinsic, "pos": position, "K": lens},
            )
        if truth:
            place = folder / "gt" / "downsampled" / synset
            place.mkdir(parents=True, exist_ok=True)
            points = sample_balls(balls=balls)[:, [0, 2, 1]] * [1, 1, -1]
            savemat(place / f"{model}.mat", {"points": points})
    return folder / "renders"


def save_disc(path, *, alpha=255):
    """An image of a disc of some opacity on nothing; the path."""
    rows, cols = np.mgrid[:40, :40]
    mask = ((rows - 20) ** 2 + (cols - 17) ** 2 < 80).astype(np.uint8)
    path.parent.mkdir(parents=True, exist_ok=True)
    image = Image.fromarray(np.dstack([90 * mask] * 3 + [alpha * mask]))
    image.save(path, format="PNG")
    return path


def write_photos(folder, *, views, seed=0, axes=(1, -1, -1), **fields):
    """Photographs of the balls from all around, anywhere in the picture.

    The world is three times as large as the object and the object far from its middle.
    A transforms.json has the cameras, of NeRF's axes (y up, looking along -z) unless
    others are given, and other fields.
    """
    folder.mkdir(parents=True)
    rng = np.random.default_rng(seed)
    shape = (90, 120)
    lens = np.array([[130.0, 0, shape[1] / 2], [0, 130.0, shape[0] / 2], [0, 0, 1]])
    middle = np.array([5.0, -3.0, 2.0])
    balls = np.concatenate([3 * BALLS[:, :3] + middle, 3 * BALLS[:, 3:]], axis=1)
    frames = []
    for view in range(views):
        angle = 2 * np.pi * (view + rng.uniform(-0.3, 0.3)) / views
        away = rng.uniform(7, 9)
        position = middle + away * np.array([np.cos(angle), np.sin(angle), 0.4])
        rotation = look_at(position, middle + rng.uniform(-0.6, 0.6, 3))
        rgba, _ = draw_balls(rotation, position, lens, shape, balls)
        Image.fromarray(rgba).save(folder / f"view{view}.png")
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = rotation.T * axes, position
        frames.append(
            {"file_path": f"./view{view}", "transform_matrix": matrix.tolist()}
        )
    content = {"fl_x": 130.0, "frames": frames} | fields
    (folder / "transforms.json").write_text(json.dumps(content))
