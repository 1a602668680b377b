"""A job of several processes, on one host or many: start and end.

Process 0 hosts jax's coordination service, and the others find it by its address. A
process that is lost ends all of them, so that the job can be started again from its
last checkpoint: by an error of the next exchange or, where process 0 is lost or not
found, or a process says nothing, by jax's client, with words of its own.
"""

import atexit
import contextlib
import errno
import logging
import os
import re
import socket
import sys
import time
from collections.abc import Iterator

import jax

from dpc_jax.files import reading
from dpc_jax.learning.training.agreement import Job
from dpc_jax.run.hosts import Place

# A process that says nothing for so long is lost: stopped, or its host is gone. Where
# virtual machines stand still at times, DPC_JAX_HEARTBEAT_SECONDS sets a longer one.
HEARTBEAT_SECONDS = 45
JOIN_SECONDS = 300  # for all processes to come; DPC_JAX_JOIN_SECONDS sets another
# Of the errors that a collective or a barrier raises, those that a lost process causes.
_LOSS = re.compile(r"[A-Z_]+: (?is:.*(gloo|nccl|coordination|barrier|socket|connect))")
_SECONDS_TO_SPEAK = 3  # that the others have before process 0 ends a job that failed


@contextlib.contextmanager
def joining(place: Place | None) -> Iterator[Job]:
    """The job that this process works in, from its start to the end of all.

    Only process 0 prints to stdout. It must be entered before jax touches a device.

    Raises:
      OSError: where the port is taken, or another process is lost.
    """
    if place is None:
        yield Job()
        return
    _connect(place)
    if place.process:
        sys.stdout = open(os.devnull, "w")
    job = Job(place.processes, place.process)
    try:
        yield job
        job.wait("end")
        jax.distributed.shutdown()
    except BaseException as error:
        # The others may never come to where jax would meet them at the end.
        is_interrupted = isinstance(error, KeyboardInterrupt)
        atexit.register(_leave, place, 130 if is_interrupted else 1)
        kinds = (ValueError, jax.errors.JaxRuntimeError)
        if isinstance(error, kinds) and _LOSS.match(str(error)):
            raise OSError(
                f"Process {place.process}: all {place.processes} processes of the job "
                "must go on, but another one has ended or cannot be reached; look at "
                "what it said last, and start all of them again: training goes on from "
                "the last checkpoint."
            ) from None
        # Let the others say what stops them too, before they see this one go.
        name = "end" if is_interrupted else "failure"  # Ctrl-C: after saving
        with contextlib.suppress(jax.errors.JaxRuntimeError, KeyboardInterrupt):
            job.wait(name, seconds=5)
        raise


def _leave(place, status):
    sys.stdout.flush()
    sys.stderr.flush()
    if not place.process:
        time.sleep(_SECONDS_TO_SPEAK)  # jax ends the others once its service is gone
    os._exit(status)


def _connect(place):
    """Start the service in process 0, and meet the others there."""
    if not place.process:
        _check_port(place.coordinator)
    # jax would catch SIGTERM for itself, so that it did not end a process that renders.
    jax.config.update("jax_enable_preemption_service", False)
    logging.getLogger("jax").setLevel(logging.ERROR)
    seconds = _read_seconds("DPC_JAX_JOIN_SECONDS", JOIN_SECONDS)
    heartbeat = _read_seconds("DPC_JAX_HEARTBEAT_SECONDS", HEARTBEAT_SECONDS)
    print(
        f"Process {place.process} waits up to {seconds} s for all {place.processes} "
        f"processes of the job at {place.coordinator}.",
        flush=True,
    )
    jax.distributed.initialize(
        place.coordinator,
        place.processes,
        place.process,
        cluster_detection_method="deactivate",
        initialization_timeout=seconds,
        heartbeat_timeout_seconds=heartbeat,
    )


def _read_seconds(variable: str, default: int) -> int:
    with reading("a whole number of seconds", variable, f"set it to {default}"):
        seconds = int(os.environ.get(variable, default))
        if seconds < 1:
            raise ValueError(f"{seconds} is less than one")
        return seconds


def _check_port(address):
    """Refuse a port that is taken: jaxlib crashes where it cannot have it."""
    port = int(address.rpartition(":")[2])
    try:
        socket.create_server(
            ("", port), family=socket.AF_INET6, dualstack_ipv6=True
        ).close()
    except OSError as error:
        if error.errno != errno.EADDRINUSE:
            return  # no IPv6 here: gRPC finds out
        raise OSError(
            f"Expected process 0 to open {address} to the other processes, but its "
            "port is taken, perhaps by the same command; end what uses it, or choose "
            "another port."
        ) from None
