"""Evaluation where poses or shapes are not known, or models differ in their views."""

import dataclasses
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tiny_runs

from dpc_jax.data.arrays import Stack
from dpc_jax.evaluation.alignment import identity_alignment
from dpc_jax.evaluation.metrics import describe_metrics
from dpc_jax.learning.inference import evaluator
from dpc_jax.learning.inference import predictor as predictor_module
from dpc_jax.learning.inference.predictor import (
    arrange_views,
    make_predictor,
    predict_all,
)
from dpc_jax.learning.shapes.kind import Choice, View
from dpc_jax.learning.shapes.points import Points
from dpc_jax.learning.signals import downsample_images
from dpc_jax.render import Camera
from dpc_jax.run.learner import Learner


def rag(dataset, counts):
    """The same set with only the first views of each model."""

    def cut(array):
        models = [rows[:count] for rows, count in zip(array, counts, strict=True)]
        return Stack(models)

    changed = {n: cut(getattr(dataset, n)) for n in ("images", "masks", "quaternions")}
    return dataset._replace(**changed)


@pytest.fixture(scope="module")
def trained():
    config = tiny_runs.tiny_config()
    network = tiny_runs.make_network(config)
    state = tiny_runs.make_state(network, config)
    last = state._replace(step=np.int32(config.train.steps))  # of the same weights
    predictor = make_predictor(network, config)
    dataset = tiny_runs.make_dataset(models=3, views=3)
    patch = pytest.MonkeyPatch()
    patch.setattr(predictor_module, "VIEWS_AT_ONCE", 4)  # of nine: three batches
    whole = predict_all(predictor, last, dataset)

    def predict(dataset, step=None):
        begun = last if step is None else last._replace(step=np.int32(step))
        return predict_all(predictor, begun, dataset)

    images = jnp.array(dataset.images.reshape(9, 16, 16, 3) / 127.5 - 1, "float32")
    yield dataset, whole, predict, jax.jit(network.apply)(state.params, images)
    patch.undo()


def test_every_view_has_its_own_predictions_and_its_best_candidate(trained):
    dataset, whole, _, output = trained
    assert whole.silhouettes.shape == (3, 3, 8, 8) and whole.colors is None
    # Nine views at once, not four: float32 sums in another order.
    np.testing.assert_allclose(
        whole.points.reshape(9, 24, 3), output["points"], atol=1e-5
    )
    np.testing.assert_allclose(whole.poses.reshape(9, 4), output["student"], atol=1e-5)
    render = tiny_runs.tiny_config().render
    targets = downsample_images(dataset.masks.reshape(9, 16, 16), 8)

    def compare(points, mass, candidates, target):
        scene = {"points": points, "mass": mass}
        scene["sigma"] = jnp.array(render.sigma_end * render.grid)
        view = View(candidates, Camera(), 8)
        return Points.compare_candidates(scene, view, {"silhouette": target}, Choice())

    losses = jax.jit(jax.vmap(compare))(
        output["points"], output["scale"], output["candidates"], targets
    )
    winners = np.argmin(losses, axis=1)
    np.testing.assert_array_equal(whole.winners.ravel(), winners)


def test_images_do_not_change_with_the_schedule_but_losses_do(trained):
    """So that errors of silhouettes can be compared over training."""
    dataset, last, predict, _ = trained
    first = predict(dataset, step=0)
    np.testing.assert_array_equal(first.silhouettes, last.silhouettes)
    assert np.all(np.abs(first.losses / last.losses - 1) > 1e-3)


def test_views_of_unequal_models_are_predicted_and_scored_one_by_one(trained):
    dataset, whole, predict, _ = trained
    options = dict(alignment=identity_alignment())
    equal = evaluator.score(whole, dataset, **options)
    ragged = rag(dataset, [3, 1, 2])
    few = predict(ragged)
    single = evaluator.score(few, ragged, **options)
    kept = [(0, 0), (0, 1), (0, 2), (1, 0), (2, 0), (2, 1)]
    models, views = arrange_views(ragged)
    assert list(zip(models.ravel(), views.ravel(), strict=True)) == kept
    assert models.shape == (6, 1)
    points = np.stack([whole.points[place] for place in kept])
    # float32; the batches differ in their composition
    np.testing.assert_allclose(few.points[:, 0], points, atol=1e-5)
    np.testing.assert_allclose(
        single.failures.errors_deg[:, 0],
        [equal.failures.errors_deg[place] for place in kept],
        atol=1e-2,  # degrees; float32 quaternions
    )
    np.testing.assert_allclose(
        single.chamfers[:, 0], [equal.chamfers[place] for place in kept], atol=1e-5
    )
    # The same views of one rendering each; their mean is over other numbers of views.
    masks = evaluator.compare_silhouettes(whole, dataset)[..., 0]
    assert single.metrics["silhouette_iou"] == pytest.approx(
        np.mean([masks[place] for place in kept]), abs=1e-4
    )


@pytest.mark.parametrize("meshes, accuracy", [("a folder", 0), ("", 1)])
def test_training_meshes_outvote_a_few_reversed_validation_objects(
    trained, monkeypatch, meshes, accuracy
):
    dataset, whole, _, _ = trained
    config = tiny_runs.tiny_config()
    data = dataclasses.replace(config.data, meshes=meshes)
    clouds = np.repeat(np.stack(dataset.surfaces)[:, None], 3, axis=1)

    def predict(_, state, split, threshold=None):
        shown = jax.tree.map(lambda a: a[: 1 if split == "val" else 3], whole)
        count = len(shown.poses)
        poses, points = np.asarray(dataset.quaternions)[:count], clouds[:count]
        if split == "val":  # learned with front and back exchanged
            poses = poses[..., ::-1] * [
                -1,
                1,
                -1,
                1,
            ]  # times the quaternion (0, 0, 0, 1)
            points = points * [-1, -1, 1]
        return shown._replace(poses=poses, points=points), None

    monkeypatch.setattr(Learner, "predict", predict)
    sets = {"train": dataset, "val": dataset.take(1), "test": dataset}
    learner = Learner(dataclasses.replace(config, data=data), sets)
    state = SimpleNamespace(step=1)
    assert learner.validate(state)["pose_accuracy"] == accuracy
    _, alignment, _ = learner.predict_test(state)
    assert abs(alignment.rotation[0]) == pytest.approx(1 - accuracy, abs=1e-3)


def test_without_shapes_chamfer_is_left_out_and_overlap_given(trained):
    dataset, whole, _, _ = trained
    dataset = dataset._replace(surfaces=None)
    alignment = evaluator.align((whole, dataset))
    result = evaluator.score(whole, dataset, alignment=alignment, chamfer_views=1)
    assert "pose_accuracy" in result.metrics and result.chamfers is None
    assert result.failures is not None
    assert not {"chamfer", "precision", "coverage"} & result.metrics.keys()
    masks = dataset.masks.reshape(3, 3, 8, 2, 8, 2).mean((3, 5)) / 255.0
    low = np.minimum(masks, whole.silhouettes).sum((2, 3))
    high = np.maximum(masks, whole.silhouettes).sum((2, 3))
    assert result.metrics["silhouette_iou"] == pytest.approx((low / high).mean())


def test_without_poses_only_the_overlap_is_left(trained):
    dataset, _, predict, _ = trained
    dataset = dataset._replace(quaternions=None, surfaces=None)
    predictions = predict(dataset)
    alignment = evaluator.align((predictions, dataset))
    result = evaluator.score(predictions, dataset, alignment=alignment)
    names = {"silhouette_iou", "projection_error", "stray_points"}
    assert set(result.metrics) == names
    assert result.failures is None
    text = describe_metrics(result.metrics, share_digits=2)
    assert text.startswith("silhouette overlap 0.")
