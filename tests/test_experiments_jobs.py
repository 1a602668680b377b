"""The job list: what is missing is trained, what fails is named, what stops goes on."""

import dataclasses
import os
import threading
import time
from pathlib import Path

import pytest
from tiny_runs import tiny_config

from dpc_jax.config import to_json
from dpc_jax.experiments import training
from dpc_jax.experiments.runs import Run
from dpc_jax.experiments.training import Job, choose_cores, train_missing

FAKE = str(Path(__file__).parent / "fake_training.py")
CONFIG = tiny_config(steps=5)


@pytest.fixture(autouse=True)
def faking(monkeypatch):
    """Runs are those of `fake_training`."""
    monkeypatch.setattr(training, "PROGRAM", (FAKE,))


def make_job(folder, name) -> Job:
    """A job by that name, in folders of its own."""
    run = Run(name, "car", "", 0, ())
    return Job(run, CONFIG, folder / name, folder / "logs" / f"{name}.txt")


def train(folder, *names, stop=None, slots=2):
    """Train jobs by these names; why they failed."""
    return train_missing(
        [make_job(folder, name) for name in names],
        cores=[-1] * slots,
        stop=stop or threading.Event(),
    )


def read_starts(folder, name):
    """The step that each start of a run began at."""
    return (folder / name / "starts").read_text().split()


def wait_for(path):
    """Wait until a file is there."""
    limit = time.monotonic() + 30
    while not path.exists():
        assert time.monotonic() < limit, f"{path} never came"
        time.sleep(0.05)


def test_jobs_are_trained_to_their_reports_and_only_once(tmp_path, capsys):
    assert train(tmp_path, "a", "b", "c") == {}
    assert all(make_job(tmp_path, name).read_metrics() for name in "abc")
    out = capsys.readouterr().out
    assert "a: begins" in out and "c ended after" in out
    assert train(tmp_path, "a", "b", "c") == {}
    assert capsys.readouterr().out == "3 of 3 runs are finished.\n"
    assert read_starts(tmp_path, "a") == ["0"]


def test_a_run_that_fails_is_named_with_its_sentence_and_the_others_go_on(tmp_path):
    failures = train(tmp_path, "fails", "a", "lies", "b", slots=1)
    assert failures["fails"] == (
        "Steps must be fewer, but they are many; take some away."
    )
    assert "status 0" in failures["lies"]
    assert set(failures) == {"fails", "lies"}
    assert make_job(tmp_path, "b").read_metrics()


def test_a_run_that_was_killed_goes_on_where_it_was(tmp_path):
    failures = train(tmp_path, "dies")
    assert "ended by SIGKILL" in failures["dies"]
    assert train(tmp_path, "dies") == {}
    assert read_starts(tmp_path, "dies") == ["0", "2"]


def test_a_stop_asks_all_runs_to_save_and_starts_no_other(tmp_path):
    stop = threading.Event()

    def stop_soon():
        for name in ("slow-a", "slow-b"):
            wait_for(tmp_path / name / "starts")
        stop.set()

    thread = threading.Thread(target=stop_soon)
    thread.start()
    assert train(tmp_path, "slow-a", "slow-b", "c", stop=stop) == {}
    thread.join()
    for name in ("slow-a", "slow-b"):
        log = (tmp_path / "logs" / f"{name}.txt").read_text()
        assert "Stopped and saved" in log
    assert not (tmp_path / "c").exists()


def test_a_folder_with_runs_of_another_size_is_refused_and_left_alone(tmp_path):
    train(tmp_path, "a")
    assert make_job(tmp_path, "a").read_metrics()
    path = tmp_path / "a" / "config.json"
    longer = dataclasses.replace(CONFIG.train, steps=6)
    path.write_text(to_json(dataclasses.replace(CONFIG, train=longer)))
    assert make_job(tmp_path, "a").read_metrics() is None
    kept = path.read_text()
    failures = train(tmp_path, "a")
    assert "train.steps (6 there, 5 here)" in failures["a"]
    assert path.read_text() == kept and read_starts(tmp_path, "a") == ["0"]


def test_cores_are_given_out_one_each(monkeypatch):
    monkeypatch.setenv("JAX_PLATFORMS", "cpu")
    cores = choose_cores()
    assert cores and set(cores) <= os.sched_getaffinity(0)
