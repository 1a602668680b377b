"""What `predict` writes of objects, without a network."""

import numpy as np

from dpc_jax.data.sets.photographs import Photographs
from dpc_jax.run import prediction_files
from dpc_jax.run.predicted_objects import PredictedObject


def make_object(poses):
    masks = np.zeros((1, 8, 8), np.uint8)
    images = np.full((1, 8, 8, 3), 255, np.uint8)
    return PredictedObject(
        photographs=Photographs("box", ("images/box.png",), images, masks),
        is_aligned=True,
        points=np.random.default_rng(0).uniform(-0.3, 0.3, (20, 3)),
        colors=None,
        mesh=None,
        poses=poses,
        silhouettes=np.full((1, 4, 4), 0.5, np.float32),
        confidences=None,
        cameras=[{}],
    )


def write(one, out, monkeypatch):
    """The entry of the one view, and the silhouette that the picture has."""
    drawn = []
    monkeypatch.setattr(
        prediction_files, "draw_predictions", lambda shown, path: drawn.extend(shown)
    )
    (entry,), _ = prediction_files.write_predictions([one], out, has_turntable=False)
    return entry, drawn[0].predicted


def test_without_poses_a_view_has_a_sentence_and_no_silhouette(tmp_path, monkeypatch):
    """It would be rendered from a pose that is not the view's."""
    entry, predicted = write(make_object(None), tmp_path, monkeypatch)
    assert entry["quaternion"] is None and np.isnan(predicted).all()
    expected = "box.png: its shape alone; this run was given poses, none is found."
    assert entry["sentence"] == expected
    entry, predicted = write(make_object(np.eye(4)[:1]), tmp_path, monkeypatch)
    assert "seen from azimuth" in entry["sentence"] and (predicted == 0.5).all()
