"""What a person reads while a run trains, on a terminal and in a log file."""

import re
import sys

from dpc_jax.learning.training.progress import ProgressReport


def show(capsys, *, seconds_left):
    with ProgressReport("Training car", total=200) as progress:
        with progress.compiling() as finish:
            finish(was_read=False)
        progress.advance(100)
        progress.report(100, loss=1.5, steps_per_second=12.3, seconds_left=seconds_left)
        with progress.compiling() as finish:
            finish(was_read=True)
    return capsys.readouterr().out


def test_plain_lines_say_that_a_program_compiles_and_how_long_it_took(capsys):
    lines = show(capsys, seconds_left=81.6).splitlines()
    assert lines[0] == "Training car: compiling"
    assert re.fullmatch(r"Training car: compiled in \d+\.\d s", lines[1])
    assert lines[2] == "Training car: step 100/200, loss 1.50, 12.3 steps/s, 82 s left"
    assert "read from the cache of compiled programs in" in lines[4]


def test_before_a_step_was_timed_no_time_is_told(capsys):
    lines = show(capsys, seconds_left=None).splitlines()
    assert lines[2] == "Training car: step 100/200, loss 1.50, 12.3 steps/s"


def test_the_bar_on_a_terminal_shows_the_same_estimate(capsys, monkeypatch):
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("FORCE_COLOR", "1")
    text = show(capsys, seconds_left=81.6)
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text)
    assert "compiled in 0.0 s" in text
    assert re.search(r"100/200 +loss 1\.50  12\.3 steps/s  82 s left", text)
    assert not re.search(r"\d:\d\d:\d\d", text)  # rich's own estimate is not there
