"""What `predict` writes of objects, without a network."""

import numpy as np
import pytest

from dpc_jax.data.sets.photographs import Photographs
from dpc_jax.run.prediction import files
from dpc_jax.run.prediction.objects import PredictedObject


@pytest.mark.parametrize(
    ("poses", "sentence"),
    [
        (None, "box.png: its shape alone; this run was given poses, none is found."),
        (np.eye(4)[:1], "box.png: seen from azimuth"),
    ],
)
def test_without_poses_a_view_has_a_sentence_and_no_silhouette(
    poses, sentence, tmp_path, monkeypatch
):
    """It would be rendered from a pose that is not the view's."""
    one = PredictedObject(
        photographs=Photographs(
            "box",
            ("images/box.png",),
            np.full((1, 8, 8, 3), 255, np.uint8),
            np.zeros((1, 8, 8), np.uint8),
            np.zeros((1, 16, 16), np.uint8),
            files=(),
        ),
        rows=np.arange(1),
        points=np.random.default_rng(0).uniform(-0.3, 0.3, (20, 3)),
        colors=None,
        poses=poses,
        silhouettes=np.full((1, 4, 4), 0.5, np.float32),
        cameras=[{}],
    )
    drawn = []
    monkeypatch.setattr(files, "write_files", lambda *_, **__: None)
    monkeypatch.setattr(files, "draw_predictions", lambda shown, _: drawn.extend(shown))
    (entry,), _ = files.write_predictions([one], tmp_path, surface="glb")
    assert entry["sentence"].startswith(sentence)
    assert (entry["quaternion"] is None) == (poses is None)
    assert np.isnan(drawn[0].predicted).all() == (poses is None)
