"""A job of several processes, on one host or many: start and end.

Process 0 hosts jax's coordination service, and the others find it by its address. A
process that is lost ends all of them, so that the job can be started again from its
last checkpoint. jax's client does that by abort(), of which Python does not hear: the
signal is caught in C, and what the client has printed is followed by our sentence.
"""

import atexit
import contextlib
import ctypes
import errno
import logging
import os
import re
import signal
import socket
import sys
from collections.abc import Iterator

import jax

from dpc_jax.run.hosts.agreement import Job
from dpc_jax.run.hosts.places import Place

# A process that says nothing for so long is lost: stopped, or its host is gone. Where
# virtual machines stand still at times, DPC_JAX_HEARTBEAT_SECONDS sets a longer one.
HEARTBEAT_SECONDS = 45
JOIN_SECONDS = 300  # for all processes to come; DPC_JAX_JOIN_SECONDS sets another
# Of the errors that a collective or a barrier raises, those that a lost process causes;
# all of jax's begin with a code.
_LOSS = re.compile(
    r"^[A-Z_]+: .*(gloo|nccl|coordination|barrier|socket closed|connection)",
    re.IGNORECASE | re.DOTALL,
)


@contextlib.contextmanager
def joining(place: Place | None) -> Iterator[Job]:
    """The job that this process works in, from its start to the end of all.

    Only process 0 prints to stdout. It must be entered before jax touches a device.

    Raises:
      OSError: where the coordinator does not answer, or another process is lost.
    """
    if place is None:
        yield Job()
        return
    _explain_aborts(place)
    _connect(place)
    job = Job(place.processes, place.process)
    try:
        if place.process:
            sys.stdout = open(os.devnull, "w")
        yield job
        job.wait("end")
        jax.distributed.shutdown()
    except BaseException as error:
        # The others may never come to where jax would meet them at the end.
        status = 130 if isinstance(error, KeyboardInterrupt) else 1
        atexit.register(_leave, status)
        is_of_jax = isinstance(error, ValueError | jax.errors.JaxRuntimeError)
        if is_of_jax and _LOSS.search(str(error)):
            raise OSError(_say_lost(place)) from None
        # Let the others say what stops them too, before they see this one go.
        name = "end" if status == 130 else "failure"  # Ctrl-C: after saving
        with contextlib.suppress(jax.errors.JaxRuntimeError, KeyboardInterrupt):
            job.wait(name, seconds=5)
        raise


def _say_lost(place: Place) -> str:
    return (
        f"Process {place.process}: all {place.processes} processes of the job at "
        f"{place.coordinator} must come and go on, but another one has ended or cannot "
        "be reached; look at what it said last, and start all of them again with the "
        "same --coordinator and --processes: training goes on from the last checkpoint."
    )


_handlers = []  # so that the functions that C calls live on


def _explain_aborts(place: Place):
    """Have abort() end this process by a sentence and exit status 1, until its end."""

    def end(_):
        os.write(2, f"Error: {_say_lost(place)}\n".encode())
        os._exit(1)

    _handlers.append(ctypes.CFUNCTYPE(None, ctypes.c_int)(end))
    ctypes.CDLL(None).signal(int(signal.SIGABRT), _handlers[-1])


def _leave(status):
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)


def _connect(place: Place):
    """Start the service in process 0, and meet the others there."""
    # jax would catch SIGTERM for itself, so that it did not end a process that renders.
    jax.config.update("jax_enable_preemption_service", False)
    logging.getLogger("jax").setLevel(logging.ERROR)
    if not place.process:
        _check_port(place.coordinator)
    seconds = int(os.environ.get("DPC_JAX_JOIN_SECONDS", JOIN_SECONDS))
    silence = int(os.environ.get("DPC_JAX_HEARTBEAT_SECONDS", HEARTBEAT_SECONDS))
    try:
        jax.distributed.initialize(
            place.coordinator,
            place.processes,
            place.process,
            cluster_detection_method="deactivate",
            initialization_timeout=seconds,
            heartbeat_timeout_seconds=silence,
        )
    except jax.errors.JaxRuntimeError as error:
        raise OSError(
            f"Expected process 0 to open {place.coordinator} to the other processes, "
            f"but it cannot ({str(error).rstrip('.')}); choose another port, or end "
            "what uses this one."
        ) from None


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
