"""The peak memory of a whole process that runs one workload and nothing else.

`python -m dpc_jax.measure.benchmark.peak '{"batch": 1, ...}'` is such a process; it
prints its peak in bytes. `null` only loads the package, as the baseline of a workload.
"""

import dataclasses
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import jax

from dpc_jax.measure.benchmark import speed
from dpc_jax.measure.benchmark.plan import Case
from dpc_jax.render import VoxelGrid, estimate_memory


def measure_case(case: Case, method: str) -> dict[str, Any]:
    """Peak of one workload in bytes, beside the estimate of `estimate_memory`.

    Raises:
      RuntimeError: the process that runs the workload fails.
    """
    request = dataclasses.asdict(case) | {"method": method}
    number = jax.ShapeDtypeStruct((), "float32")
    estimate = estimate_memory(
        jax.ShapeDtypeStruct((case.points, 3), "float32"),
        jax.ShapeDtypeStruct((4,), "float32"),
        sigma=number,
        scale=number,
        grid=VoxelGrid(case.side),
        method=method,
        gradient=True,
    )
    return {
        "case": str(case),
        "method": method,
        "extra_bytes": run_alone(request) - run_alone(None),
        "estimate_bytes": estimate.total,  # of one sample
        "all_cells_bytes": 4 * case.points * case.side**3,  # what N·D³ would take
    }


def run_alone(request: dict[str, Any] | None) -> int:
    """The peak of a process of its own; an error has the last line that it printed."""
    command = [sys.executable, "-m", "dpc_jax.measure.benchmark.peak"]
    command.append(json.dumps(request))
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        said = done.stderr.strip().splitlines() or ["nothing"]
        raise RuntimeError(
            f"Expected the process of {request} to succeed, but it ended with status "
            f"{done.returncode} ({said[-1]}); free some memory, or leave memory out of "
            "--parts."
        )
    return int(done.stdout.split()[-1])


def read_peak() -> int:
    """Largest resident size of this process so far, in bytes."""
    status = Path("/proc/self/status")
    if status.is_file():
        # Not getrusage: on Linux its maximum is inherited from the starting process.
        for line in status.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024
    import resource  # which Windows lacks

    size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return size if sys.platform == "darwin" else size * 1024


if __name__ == "__main__":
    wanted = json.loads(sys.argv[1])
    if wanted is not None:
        method = wanted.pop("method")
        jax.block_until_ready(speed.prepare_render(Case(**wanted), method=method)())
    print(read_peak())
