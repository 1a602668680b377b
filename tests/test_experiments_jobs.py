"""The job list: what is missing is trained, what fails is named, what stops goes on."""

import contextlib
import dataclasses
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from tiny_runs import tiny_config

from dpc_jax.config import to_json
from dpc_jax.experiments.jobs.forecast import Forecast, guess_seconds
from dpc_jax.experiments.jobs.progress import JobProgress, describe_time
from dpc_jax.experiments.jobs.training import Job, choose_cores, train_missing
from dpc_jax.experiments.runs import Run

FAKE = Path(__file__).parent / "fake_training.py"
CONFIG = tiny_config(steps=5)


def make_job(folder, name) -> Job:
    """A job whose training `fake_training` plays."""
    workdir = folder / name
    workdir.mkdir(exist_ok=True)
    (workdir / "config.json").write_text(to_json(CONFIG))
    run = Run(name, "car", "", 0, ())
    return Job(run, CONFIG, workdir, folder / "logs" / f"{name}.txt")


def train(folder, *names, stop=None, slots=2, on_end=lambda job: None):
    """Train jobs by these names; why they failed."""
    jobs = [make_job(folder, name) for name in names]
    with JobProgress(total=len(jobs), done=0) as progress:
        return train_missing(
            jobs,
            cores=[-1] * slots,
            progress=progress,
            stop=stop or threading.Event(),
            on_end=on_end,
            program=[str(FAKE)],
        )


def read_starts(folder, name):
    """The step that each start of a run began at."""
    return (folder / name / "starts").read_text().split()


def wait_for(path, seconds=30):
    """Wait until a file is there."""
    limit = time.monotonic() + seconds
    while not path.exists():
        assert time.monotonic() < limit, f"{path} never came"
        time.sleep(0.05)


def test_jobs_are_trained_to_their_reports(tmp_path, capsys):
    assert train(tmp_path, "a", "b", "c") == {}
    assert all(make_job(tmp_path, name).is_finished() for name in "abc")
    out = capsys.readouterr().out
    assert "a: begins" in out and "c: finished in" in out


def test_the_next_run_begins_before_the_end_of_one_is_dealt_with(tmp_path):
    """The page that is written then takes seconds, in which a core would rest."""
    ended = []

    def note(job):
        begun = {path.stem for path in (tmp_path / "logs").iterdir()}
        ended.append((job.run.name, begun))

    train(tmp_path, "a", "b", slots=1, on_end=note)
    assert ended == [("a", {"a", "b"}), ("b", {"a", "b"})]


def test_a_run_that_fails_is_named_with_its_sentence_and_the_others_go_on(tmp_path):
    failures = train(tmp_path, "fails", "a", "lies", "b", slots=1)
    assert failures["fails"] == (
        "Steps must be fewer, but they are many; take some away."
    )
    assert "ended with status 0" in failures["lies"]
    assert set(failures) == {"fails", "lies"}
    assert make_job(tmp_path, "b").is_finished()


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
    assert not (tmp_path / "c" / "starts").exists()


PARENT = """
import sys, threading
from pathlib import Path
import test_experiments_jobs as tests
tests.train(Path(sys.argv[1]), "slow")
"""


def test_runs_save_and_end_when_the_command_is_killed(tmp_path):
    """By the kernel: the command itself cannot do anything any more."""
    command = subprocess.Popen(
        [sys.executable, "-c", PARENT, str(tmp_path)], cwd=FAKE.parent
    )
    wait_for(tmp_path / "slow" / "starts")
    os.kill(command.pid, signal.SIGKILL)
    command.wait()
    log, limit = tmp_path / "logs" / "slow.txt", time.monotonic() + 30
    try:
        while "Stopped and saved" not in log.read_text():
            assert time.monotonic() < limit
            time.sleep(0.05)
    finally:  # where the kernel did not do it
        with contextlib.suppress(ProcessLookupError):
            os.kill(int((tmp_path / "slow" / "pid").read_text()), signal.SIGKILL)


def test_a_report_of_another_config_does_not_count(tmp_path):
    train(tmp_path, "a")
    job = make_job(tmp_path, "a")
    assert job.is_finished()
    longer = dataclasses.replace(CONFIG.train, steps=6)
    other = dataclasses.replace(CONFIG, train=longer)
    assert not dataclasses.replace(job, config=other).is_finished()
    (job.workdir / "report" / "index.html").unlink()
    assert not job.is_finished()


def test_the_forecast_learns_from_runs_that_have_ended(tmp_path):
    jobs = [make_job(tmp_path, name) for name in "abcd"]
    forecast, guess = Forecast(jobs), guess_seconds(CONFIG)
    before = forecast.estimate([], jobs, slots=2)
    assert before == pytest.approx(2 * guess)  # four jobs, two at once
    forecast.finish(jobs[0], 3 * guess, 0)
    assert forecast.factor == pytest.approx(3)
    after = forecast.estimate([], jobs[1:], slots=1)
    assert after == pytest.approx(9 * guess)


def test_cores_are_given_out_one_each(monkeypatch):
    monkeypatch.setenv("JAX_PLATFORMS", "cpu")
    cores = choose_cores()
    assert cores and set(cores) <= os.sched_getaffinity(0)
    assert choose_cores(1) == cores[:1]


def test_times_are_said_in_the_unit_that_fits():
    assert [describe_time(s) for s in (40, 720, 12600)] == ["40 s", "12 min", "3.5 h"]
