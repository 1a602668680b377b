"""Camera poses that come with a user's own images.

Three forms are read. `poses.json` maps the name of an image to a quaternion wxyz, from
the object to a camera that looks straight at it. `transforms.json`, as NeRF tools write
it, has a camera-to-world matrix for each image and the lens; its cameras look along -z
with y up, unless the file says `"convention": "opencv"` (along +z, y down). A model of
COLMAP, binary or text, lies beside the images, in `sparse` or in `sparse/0`.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from dpc_jax import files
from dpc_jax.files import Damage

QUATERNIONS = "poses.json"
TRANSFORMS = "transforms*.json"
COLMAP = ("images.bin", "images.txt")  # beside which its cameras lie
_PLACES = (Path(), Path("sparse"), Path("sparse", "0"))  # of them in an object's folder
LENS = ("fl_x", "fl_y", "cx", "cy", "w", "h", "camera_angle_x")


class Pose(NamedTuple):
    """Where the camera of an image stood.

    rotation: [3, 3], world or object to camera (x right, y down, z forward).
    position: [3] of the camera in the world, or None where only the rotation is known.
    lens: focal length and centre in pixels as far as the file has them, named as in
        `LENS`.
    """

    rotation: np.ndarray
    position: np.ndarray | None = None
    lens: dict | None = None


def find_pose_files(folder: Path) -> list[Path]:
    """The pose files in an object's folder, sorted; an object of one image has none."""
    found = [folder / QUATERNIONS] if (folder / QUATERNIONS).is_file() else []
    found += sorted(p for p in folder.glob(TRANSFORMS) if p.is_file())
    models = (folder / place / name for place in _PLACES for name in COLMAP)
    return found or [path for path in models if path.is_file()][:1]


def read_poses(paths: Sequence[Path]) -> dict[Path, Pose]:
    """Poses by image path from the pose files of one object."""
    poses = {}
    for path in paths:
        with files.reading("poses", path, "see docs/data.md for their form"):
            if path.name in COLMAP:
                poses |= _read_colmap(path)
                continue
            content = files.read_json(path)
            if not isinstance(content, dict):
                kind = "a list" if isinstance(content, list) else "a single value"
                raise Damage(f"it holds {kind}, not names and what belongs to them")
            read = _read_quaternions if path.name == QUATERNIONS else _read_transforms
            poses |= read(content, path.parent)
    return poses


def _read_quaternions(content, folder):
    poses = {}
    for name, values in content.items():
        quaternion = np.asarray(values, dtype=np.float64)
        length = np.linalg.norm(quaternion)
        if quaternion.shape != (4,) or not np.isfinite(length) or length < 1e-6:
            raise Damage(
                f"{name} needs four numbers that are not all 0, but has {values}"
            )
        rotation = Rotation.from_quat(quaternion, scalar_first=True)
        poses[folder / name] = Pose(rotation.as_matrix())
    return poses


def _read_transforms(content, folder):
    axes = {"opengl": np.diag([1.0, -1.0, -1.0]), "opencv": np.eye(3)}
    turn = axes[content.get("convention", "opengl").lower()]
    shared = {name: content[name] for name in LENS if name in content}
    poses = {}
    for frame in content["frames"]:
        matrix = np.asarray(frame["transform_matrix"], dtype=np.float64)
        if matrix.shape not in ((3, 4), (4, 4)) or not np.isfinite(matrix).all():
            raise Damage(
                f"{frame['file_path']} has no finite transform_matrix [4, 4], but "
                f"{frame['transform_matrix']}"
            )
        turned = matrix[:3, :3] @ turn  # columns: the camera's axes in the world
        if not np.abs(turned.T @ turned - np.eye(3)).max() < 1e-2:
            raise Damage(f"{frame['file_path']} has no rigid transform_matrix")
        if np.linalg.det(turned) < 0:
            raise Damage(f"{frame['file_path']} has a mirrored transform_matrix")
        # the nearest rotation: files carry a few digits only
        rotation = Rotation.from_matrix(turned.T).as_matrix()
        lens = shared | {name: frame[name] for name in LENS if name in frame}
        _expect_lens(lens)
        path = _find_image(folder / frame["file_path"])
        poses[path] = Pose(rotation, matrix[:3, 3], lens)
    return poses


def _read_colmap(path):
    try:
        import pycolmap  # pyright: ignore[reportMissingImports]  # optional
    except ModuleNotFoundError:
        text = "models of COLMAP need pycolmap; pip install 'dpc_jax[colmap]' brings it"
        raise Damage(text) from None
    place = folder = path.parent
    if place.parts[-2:] == ("sparse", "0"):
        folder = place.parents[1]
    elif place.name == "sparse":
        folder = place.parent
    poses = {}
    for image in pycolmap.Reconstruction(str(place)).images.values():
        camera, pose = image.camera, image.cam_from_world()
        if not camera.is_undistorted():
            raise Damage(
                f"the lens of {image.name} is distorted; take the images and the model "
                "that colmap image_undistorter makes"
            )
        rotation = np.asarray(pose.rotation.matrix())
        lens = (camera.focal_length_x, camera.focal_length_y)
        lens += (camera.principal_point_x, camera.principal_point_y)
        lens = dict(zip(LENS, (*lens, camera.width, camera.height), strict=False))
        beside = folder / "images" / image.name
        file = beside if beside.is_file() else folder / image.name
        poses[file] = Pose(rotation, -rotation.T @ pose.translation, lens)
    return poses


def _expect_lens(lens):
    for name, value in lens.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise Damage(f"{name} is {value!r} instead of a number")
        # only the centre may lie at 0 or beyond the image
        if not np.isfinite(value) or not (name in ("cx", "cy") or value > 0):
            raise Damage(f"{name} is {value}, which is impossible for a lens")
    if lens.get("camera_angle_x", 1.0) >= np.pi:
        raise Damage(f"camera_angle_x is {lens['camera_angle_x']} radians")


def _find_image(path):
    """The image file of a frame, whose ending NeRF's own files leave out."""
    if not path.suffix or not path.is_file():
        for suffix in (".png", ".jpg", ".jpeg", ".webp"):
            if (whole := path.with_name(path.name + suffix)).is_file():
                return whole
    return path
