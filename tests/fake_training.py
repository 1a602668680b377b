"""Stands for dpc_jax.main in tests of the job list: five steps, saved one by one.

The folder's name says what goes wrong: "fails", "slow" (a step takes a minute), "dies"
(killed after two steps in its first start), "lies" (status 0 without a report).
"""

import json
import os
import signal
import sys
import time
from pathlib import Path

STEPS = 5


def main():
    (workdir,) = (
        Path(word.partition("=")[2]) for word in sys.argv if "--workdir=" in word
    )
    stopped = []
    signal.signal(signal.SIGTERM, lambda *_: stopped.append(True))
    log = workdir / "metrics.jsonl"
    begun = len(log.read_text().splitlines()) if log.exists() else 0
    (workdir / "pid").write_text(str(os.getpid()))
    with open(workdir / "starts", "a") as file:
        file.write(f"{begun}\n")
    if "fails" in workdir.name:
        print("Rendering.")
        print("Error: Steps must be fewer, but they are many; take some away.")
        sys.exit(1)
    for step in range(begun + 1, STEPS + 1):
        for _ in range(600 if "slow" in workdir.name else 1):
            if stopped:
                print(f"Stopped and saved at step {step - 1}.")
                return
            time.sleep(0.1)
        with open(log, "a") as file:
            file.write(json.dumps({"step": step, "seconds": step}) + "\n")
        if "dies" in workdir.name and step == 2:
            os.kill(os.getpid(), signal.SIGKILL)
    if "lies" not in workdir.name:
        (workdir / "report").mkdir()
        (workdir / "report" / "metrics.json").write_text('{"chamfer": 4.0}')
        (workdir / "report" / "index.html").write_text("report")


main()
