"""The published renders, read from a small tree of the same form."""

import numpy as np
from data_trees import BALLS, sample_balls, share_inside, write_renders
from PIL import Image
from scipy.io import loadmat, savemat

from dpc_jax.data import DataSpec, load_or_render

SPEC = dict(category="car", kind="renders", views=2, image_size=28)
NAMES = [f"model{i}" for i in range(5)]


def load(folder, cache, **changes):
    spec = DataSpec(**SPEC | {"folder": str(folder)} | changes)
    return load_or_render(spec, cache_dir=cache, processes=1)


def test_renders_arrive_with_their_poses_depth_and_ground_truth(tmp_path):
    folder = write_renders(tmp_path, NAMES)
    data = load(folder, tmp_path / "cache", split="test", fractions=(0, 0, 1))
    assert data.names == tuple(NAMES) and data.images.shape == (5, 2, 28, 28, 3)
    for model, view in np.ndindex(5, 2):
        points = sample_balls(balls=BALLS * (0.9 + 0.1 * model / 4))
        mask, pose = data.masks[model, view], data.quaternions[model, view]
        # a ray per pixel of 112 misses slivers at the rim
        assert share_inside(points, pose, mask) > 0.97
        np.testing.assert_allclose(
            np.sort(data.surfaces[model], axis=0), np.sort(points, axis=0), atol=1e-6
        )
        # Depth is that of the file where the whole pixel is covered.
        path = folder / "02958343" / NAMES[model] / f"depth_{view}.png"
        raw = np.asarray(Image.open(path)).astype(float) * 10 / 65535
        covered, depth = mask == 255, raw.reshape(28, 4, 28, 4).mean((1, 3))
        assert covered.any()
        np.testing.assert_allclose(
            data.depths[model, view][covered], depth[covered], rtol=1e-6
        )
        assert (data.depths[model, view][mask == 0] == 0).all()
        assert (data.images[model, view][mask == 0] == 255).all()


def test_training_models_have_no_ground_truth_and_need_none(tmp_path):
    folder = write_renders(tmp_path, NAMES, truth=False)
    data = load(folder, tmp_path / "cache", fractions=(1, 0, 0))
    assert data.surfaces is None and len(data.names) == 5


def cut(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def widen(path):
    content = loadmat(path)
    content["K"][0, 0] *= 2
    savemat(path, {key: content[key] for key in ("extrinsic", "K")})


def empty(path):
    path.unlink()
    path.with_name("render_2.png").unlink()


def shorten(path):
    Image.fromarray(np.zeros((112, 112), np.uint8)).save(path)


TRUTH = "../../../gt/downsampled/02958343/truth.mat"
HARMS = {  # a file of each model, what is done to it, and what is said of it
    "colors": ("render_0.png", cut, "render_0.png"),
    "depth": ("depth_1.png", cut, "depth_1.png"),
    "bytes": ("depth_0.png", shorten, "16-bit depth"),
    "camera": ("camera_0.mat", cut, "camera_0.mat"),
    "lens": ("camera_1.mat", widen, "focal length 1.875 and distance 2.0"),
    "shapes": (
        "camera_0.mat",
        lambda path: savemat(path, {"extrinsic": np.eye(3), "K": np.eye(3)}),
        "extrinsic [4, 4] and K [3, 3] in",
    ),
    "few": ("render_1.png", empty, "2 views render_N.png in"),
    "truth": (TRUTH, lambda path: path.unlink(), "truth.mat, but it is missing"),
}


def test_damaged_models_are_left_out_and_their_files_named(tmp_path):
    folder = write_renders(tmp_path, ["whole", *HARMS])
    for model, (file, harm, _) in HARMS.items():
        harm(folder / "02958343" / model / file)
    data = load(folder, tmp_path / "cache", split="test", fractions=(0, 0, 1))
    assert data.names == ("whole",)
    reasons = dict(data.skipped)
    assert reasons.keys() == HARMS.keys()
    for model, (_, _, said) in HARMS.items():
        assert said in reasons[model]
