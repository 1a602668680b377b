"""The loop: it ends where an unbroken run ends, whatever stops it on the way."""

import dataclasses
import functools
import json
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tiny_runs import (
    assert_same_bits,
    make_dataset,
    make_network,
    make_state,
    tiny_config,
)

from dpc_jax.config import Log
from dpc_jax.learning.inference import evaluator
from dpc_jax.learning.inference.predictor import make_predictor, predict_all
from dpc_jax.learning.losses import downsample_images
from dpc_jax.learning.renders import compute_candidate_losses
from dpc_jax.learning.schedules import compute_sigma
from dpc_jax.learning.shapes.points import Points
from dpc_jax.learning.step import make_train_step
from dpc_jax.learning.training import loop
from dpc_jax.learning.training import records as recording
from dpc_jax.learning.training.checkpoints import Checkpoints
from dpc_jax.learning.training.records import (
    MetricLog,
    NonFiniteError,
    check_finite,
    check_growth,
    summarize,
)
from dpc_jax.render import Camera

CONFIG = tiny_config(steps=8)  # two stages of four steps
NETWORK = make_network(CONFIG)
DATASET = make_dataset()
SCORES = {"pose_accuracy": 0.5, "pose_median_error_deg": 45.0, "chamfer": 7.0}

# Each program here runs a few steps.
pytestmark = pytest.mark.usefixtures("quickly")

_compile = functools.lru_cache(loop.make_train_step)


def compile_once(network, config, stage):
    """The step of a stage, whose gradients are measured as for a log of every step."""
    return _compile(network, dataclasses.replace(config, log=CONFIG.log), stage)


@pytest.fixture(autouse=True)
def share_compiled_steps(monkeypatch):
    """All loops of this file use the same two programs; compiling takes seconds."""
    monkeypatch.setattr(loop, "make_train_step", compile_once)


@pytest.fixture(scope="module")
def first_state():
    return make_state(NETWORK, CONFIG)


@pytest.fixture(scope="module")
def unbroken(first_state, tmp_path_factory):
    """The last state of a run that nothing stopped."""
    folder = tmp_path_factory.mktemp("unbroken")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loop, "make_train_step", compile_once)
        return run_loop(folder, first_state, every=(1, 0, 0)).state


def copy_from_host(state):
    # A restored array is bound to its device, which would compile everything anew.
    return jax.tree.map(lambda a: jnp.array(np.asarray(a)), state)


def run_loop(folder, state, *, every=(1, 0, 2), **changes):
    checkpoints = Checkpoints(folder / "checkpoints")
    try:
        return loop.train(
            copy_from_host(state),
            DATASET,
            network=NETWORK,
            config=dataclasses.replace(CONFIG, log=Log(*every)),
            checkpoints=checkpoints,
            log=MetricLog(folder / "metrics.jsonl"),
            **changes,
        )
    finally:
        checkpoints.close()


def restore(folder, state):
    checkpoints = Checkpoints(folder / "checkpoints")
    restored = checkpoints.restore(state)
    steps = checkpoints.steps()
    checkpoints.close()
    return restored, steps


def read(folder):
    return MetricLog(folder / "metrics.jsonl").read()


def stop_after(count, monkeypatch):
    """Asks to stop from the end of the count-th step on."""
    steps, add = [], loop.Window.add

    def count_step(window, metrics):
        steps.append(metrics)
        add(window, metrics)

    monkeypatch.setattr(loop.Window, "add", count_step)
    return lambda: len(steps) >= count


def test_the_loop_ends_at_the_last_step_with_a_checkpoint_of_it(
    tmp_path, first_state, unbroken
):
    outcome = run_loop(tmp_path, first_state)
    assert outcome.is_finished and int(outcome.state.step) == 8
    assert_same_bits(outcome.state, unbroken)
    restored, steps = restore(tmp_path, first_state)
    assert steps == [6, 8]
    # Written while the steps after it took its memory, and yet the same bits.
    assert restored.damaged == ()
    assert_same_bits(restored.state, unbroken)


def test_compiling_ahead_changes_no_bit(tmp_path, first_state, unbroken, monkeypatch):
    # Programs of its own, not those that the other tests share.
    monkeypatch.setattr(loop, "make_train_step", make_train_step)
    outcome = run_loop(tmp_path, first_state, compile_ahead=False)
    assert_same_bits(outcome.state, unbroken)
    # Training waited for both stages, the second of which begins after step 4.
    waited = [r["step"] for r in read(tmp_path) if "compile_seconds" in r]
    assert waited == [1, 5]


@pytest.mark.parametrize("count", [1, 3, 4, 7])
def test_a_run_that_stops_saves_and_then_ends_as_one_that_did_not(
    tmp_path, first_state, unbroken, count, monkeypatch
):
    stop = stop_after(count, monkeypatch)
    outcome = run_loop(tmp_path, first_state, every=(1, 0, 0), should_stop=stop)
    assert not outcome.is_finished
    restored, steps = restore(tmp_path, first_state)
    assert steps == [count] and int(restored.state.step) == count
    outcome = run_loop(tmp_path, restored.state, seconds=restored.seconds)
    assert outcome.is_finished
    assert_same_bits(outcome.state, unbroken)
    assert [r["step"] for r in read(tmp_path)] == list(range(1, 9))


def test_a_run_asked_to_stop_at_its_last_step_is_finished(
    tmp_path, first_state, monkeypatch
):
    stop = stop_after(8, monkeypatch)
    outcome = run_loop(tmp_path, first_state, should_stop=stop)
    assert outcome.is_finished


def test_seconds_go_on_where_the_run_before_stopped(tmp_path, first_state):
    outcome = run_loop(tmp_path, first_state, seconds=1000.0)
    seconds = [r["seconds"] for r in read(tmp_path)]
    assert seconds == sorted(seconds) and seconds[0] >= 1000
    assert outcome.seconds >= seconds[-1]
    restored, _ = restore(tmp_path, first_state)
    assert restored.seconds >= 1000


def test_log_validation_and_checkpoints_come_at_their_intervals_and_at_the_end(
    tmp_path, first_state
):
    seen = []

    def evaluate(state):
        seen.append(int(state.step))
        return SCORES

    run_loop(tmp_path, first_state, every=(3, 5, 7), evaluate=evaluate)
    records = read(tmp_path)
    assert [r["step"] for r in records if "loss" in r] == [3, 6, 8]
    assert [r["step"] for r in records if "chamfer" in r] == [5, 8] == seen
    assert restore(tmp_path, first_state)[1] == [7, 8]


def test_the_time_of_a_validation_is_not_training_time(
    tmp_path, first_state, monkeypatch
):
    # A clock that only the validation moves.
    now = [0.0]
    monkeypatch.setattr(recording.time, "monotonic", lambda: now[0])

    def evaluate(state):
        now[0] += 500.0
        return SCORES

    outcome = run_loop(tmp_path, first_state, every=(4, 4, 4), evaluate=evaluate)
    assert now[0] == 1000.0
    assert [r["seconds"] for r in read(tmp_path)] == [0, 0, 0, 0]
    assert outcome.seconds == 0


def test_a_record_has_what_the_report_and_a_person_want_to_see(tmp_path, first_state):
    run_loop(tmp_path, first_state, every=(4, 0, 0))
    record = read(tmp_path)[0]
    assert {"step", "seconds", "loss", "reprojection", "student"} <= record.keys()
    assert sum(record["head_shares"]) == pytest.approx(1, abs=1e-3)
    assert {"gradient_norm_encoder", "gradient_norm_pose"} <= record.keys()
    json.dumps(record, allow_nan=False)


def test_a_log_line_is_the_mean_over_its_steps(tmp_path, first_state):
    run_loop(tmp_path / "single", first_state, every=(1, 0, 0))
    run_loop(tmp_path / "pairs", first_state, every=(2, 0, 0))
    single = [r["loss"] for r in read(tmp_path / "single")]
    # float64 means of the same float32 numbers.
    assert [r["loss"] for r in read(tmp_path / "pairs")] == pytest.approx(
        np.mean(np.reshape(single, (4, 2)), axis=1)
    )


def test_turned_candidates_count_for_their_head():
    metrics = {"loss": 1.0, "winners": np.array([0, 3, 7, 11]), "gradient_norms": {}}
    record = summarize([metrics], heads=CONFIG.pose.heads)
    assert record["head_shares"] == [0.5, 0.25, 0.25]


def test_a_log_line_has_the_gradients_that_were_measured():
    def take(*norms):
        window = [{"loss": 1.0, "gradient_norms": {"shape": n}} for n in norms]
        return summarize(window, heads=0).get("gradient_norm_shape")

    assert take(-1.0, 3.0, -1.0, 5.0) == 4.0
    assert take(-1.0, -1.0) is None


def test_a_loss_of_one_stage_is_averaged_over_the_steps_that_have_it():
    """As where EPCG's first stage ends within a window."""
    first = {"loss": np.float32(3), "astray": np.float32(2), "gradient_norms": {}}
    second = {"loss": np.float32(1), "gradient_norms": {}}
    for window in ([first, second, second], [second, second, first]):
        record = summarize(window, heads=0)
        assert record["loss"] == pytest.approx(5 / 3) and record["astray"] == 2.0


# What is not finite.


def poison(step_at, *names):
    """`make_train_step` whose parameters of these names turn bad before a step."""

    def spoil(path, leaf):
        found = {key.key for key in path}
        return jnp.full_like(leaf, jnp.nan) if found.issuperset(names) else leaf

    def make(network, config, stage):
        jitted = compile_once(network, config, stage)

        def lower(*structs):
            good = jitted.lower(*structs).compile()
            step = functools.partial(run, good)
            return SimpleNamespace(compile=lambda: step)

        def run(good, state, batch):
            if int(state.step) == step_at:
                params = jax.tree_util.tree_map_with_path(spoil, state.params)
                state = state._replace(params=params)
            return good(state, batch)

        return SimpleNamespace(lower=lower)

    return make


@pytest.mark.parametrize("every", [(1, 0, 2), (100, 0, 4), (5, 0, 2), (100, 0, 1)])
def test_the_first_loss_that_is_not_finite_stops_with_its_name_and_step(
    tmp_path, first_state, monkeypatch, every
):
    monkeypatch.setattr(loop, "make_train_step", poison(5, "shape", "scale"))
    # The NaN is meant, so JAX_DEBUG_NANS must not stop it first; so below.
    with (
        jax.debug_nans(False),
        pytest.raises(NonFiniteError, match="reprojection loss became nan at step 5"),
    ):
        run_loop(tmp_path, first_state, every=every)
    restored, steps = restore(tmp_path, first_state)
    assert steps[-1] == (5 if every[2] == 1 else 4)
    # The last checkpoint is the last good state: an unbroken run goes on from there.
    monkeypatch.setattr(loop, "make_train_step", compile_once)
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(restored.state))
    assert all(np.isfinite(r["loss"]) for r in read(tmp_path))


def test_a_student_that_is_not_finite_is_named(tmp_path, first_state, monkeypatch):
    monkeypatch.setattr(loop, "make_train_step", poison(2, "student"))
    with (
        jax.debug_nans(False),
        pytest.raises(NonFiniteError, match="student loss became nan at step 2"),
    ):
        run_loop(tmp_path, first_state)


def test_a_loss_that_grows_without_bound_ends_the_run_at_the_last_good_checkpoint(
    tmp_path, first_state, monkeypatch
):
    def grow(network, config, stage):
        good = compile_once(network, config, stage)

        def lower(*structs):
            program = good.lower(*structs).compile()
            return SimpleNamespace(compile=lambda: functools.partial(run, program))

        def run(program, state, batch):
            step = int(state.step)
            state, metrics = program(state, batch)
            return state, metrics | {"loss": metrics["loss"] * 1e3 ** (step >= 5)}

        return SimpleNamespace(lower=lower)

    monkeypatch.setattr(loop, "make_train_step", grow)
    with pytest.raises(NonFiniteError, match=r"diverged: the loss grew from .* step 5"):
        run_loop(tmp_path, first_state, every=(100, 0, 1))
    restored, steps = restore(tmp_path, first_state)
    assert steps[-1] == int(restored.state.step) == 5


@pytest.mark.parametrize(("first", "loss"), [(30.0, 2900.0), (-0.1, 50.0), (0, -99)])
def test_a_loss_that_varies_is_no_divergence(first, loss):
    check_growth(first, loss, 12)


@pytest.mark.parametrize("value", [np.inf, np.nan])
def test_a_gradient_that_is_not_finite_is_named_though_the_loss_is(value):
    metrics = {"loss": 1.0, "gradient_norms": {"encoder": 1.0, "pose": value}}
    with pytest.raises(NonFiniteError, match=r"gradient of the pose .* at step 12"):
        check_finite(metrics, 12)
    for finite in (0.0, -1.0):  # -1: not measured in this step
        check_finite({"loss": 1.0, "gradient_norms": {"pose": finite}}, 12)


# Predictions for a whole data set.


@pytest.fixture(scope="module")
def predictions(unbroken):
    predictor = make_predictor(NETWORK, CONFIG)
    # Nine views, four at a time: the last batch has one and three to fill it up.
    return predict_all(predictor, unbroken, DATASET, views_at_once=4)


@pytest.fixture(scope="module")
def output(unbroken):
    """What the network says of the nine views at once."""
    images = DATASET.images.reshape(9, 16, 16, 3) / 127.5 - 1.0
    return jax.jit(NETWORK.apply)(unbroken.params, jnp.array(images, jnp.float32))


def test_every_view_has_its_own_predictions_in_its_place(predictions, output):
    assert predictions.points.shape == (3, 3, 24, 3)
    assert predictions.silhouettes.shape == (3, 3, 8, 8)
    assert predictions.colors is None
    # Nine views at once, not four: float32 sums in another order.
    np.testing.assert_allclose(
        predictions.points.reshape(9, 24, 3), output["points"], atol=1e-5
    )
    np.testing.assert_allclose(
        predictions.poses.reshape(9, 4), output["student"], atol=1e-5
    )


def test_the_best_candidate_is_the_one_whose_silhouette_fits_best(predictions, output):
    targets = downsample_images(DATASET.masks.reshape(9, 16, 16), 8)
    sigma = compute_sigma(8, CONFIG.render, steps=8)

    def compare(points, mass, candidates, target):
        scene = {"points": points, "mass": mass, "sigma": sigma}
        return compute_candidate_losses(
            Points, scene, candidates, target, camera=Camera()
        )

    losses = jax.jit(jax.vmap(compare))(
        output["points"], output["scale"], output["candidates"], targets
    )
    winners = np.argmin(losses, axis=1)
    np.testing.assert_array_equal(predictions.winners.ravel(), winners)
    np.testing.assert_allclose(
        predictions.candidate_poses.reshape(9, 4),
        np.asarray(output["candidates"])[np.arange(9), winners],
        atol=1e-5,
    )


def test_scores_have_the_names_that_the_report_needs_and_shares_of_the_heads(
    predictions,
):
    alignment = evaluator.align(predictions, DATASET)
    result, shares = evaluator.score(predictions, DATASET, alignment=alignment, heads=3)
    wanted = "pose_accuracy pose_median_error_deg chamfer precision coverage".split()
    assert set(wanted) <= result.metrics.keys()
    assert all(np.isfinite(v) for v in result.metrics.values())
    np.testing.assert_allclose(
        shares, np.bincount(predictions.winners.ravel(), minlength=3) / 9
    )
