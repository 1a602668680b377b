"""A job of several processes, on one host or many: start and end.

Process 0 hosts jax's coordination service, and the others find it by its address. A
process that is lost ends all of them, so that the job can be started again from its
last checkpoint.
"""

import atexit
import contextlib
import errno
import logging
import os
import re
import socket
import sys
from collections.abc import Iterator

import jax

from dpc_jax.run.hosts.aborts import speaking_for_jax
from dpc_jax.run.hosts.agreement import Job
from dpc_jax.run.hosts.places import Place

# A process that says nothing for so long is lost: stopped, or its host is gone. Where
# virtual machines stand still at times, DPC_JAX_HEARTBEAT_SECONDS sets a longer one.
HEARTBEAT_SECONDS = 45
JOIN_SECONDS = 300  # for all processes to come; DPC_JAX_JOIN_SECONDS sets another
AGAIN = "start all of them again: training goes on from the last checkpoint"
# Of the errors that a collective or a barrier raises, those that a lost process causes.
_LOSS = re.compile(r"gloo|nccl|coordination|barrier|socket closed|connection", re.I)


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
    seconds = _read_seconds("JOIN", JOIN_SECONDS)
    words, job = _Words(place, seconds), Job(place.processes, place.process)
    with speaking_for_jax(words.explain) as speak_itself:
        try:
            _connect(place, seconds)
            words.has_joined = True
            if place.process:
                sys.stdout = open(os.devnull, "w")
            yield job
            job.wait("end")
            jax.distributed.shutdown()
        except BaseException as error:
            speak_itself()
            # The others may never come to where jax would meet them at the end.
            status = 130 if isinstance(error, KeyboardInterrupt) else 1
            atexit.register(_leave, status)
            if words.is_loss(error):
                raise OSError(words.explain(str(error))) from None
            if words.has_joined:
                # Let the others say what stops them too, before they see this one go.
                name = "end" if status == 130 else "failure"  # Ctrl-C: after saving
                with contextlib.suppress(jax.errors.JaxRuntimeError, KeyboardInterrupt):
                    job.wait(name, seconds=5)
            raise


def _read_seconds(name, default):
    variable = f"DPC_JAX_{name}_SECONDS"
    given = os.environ.get(variable, str(default))
    if not given.isdigit() or int(given) < 1:
        raise ValueError(
            f"{variable} must be a whole number of seconds, at least one, but it is "
            f"{given!r}; set it to {default}, for instance."
        )
    return int(given)


def _leave(status):
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)


def _connect(place, seconds):
    """Start the service in process 0, and meet the others there."""
    # jax would catch SIGTERM for itself, so that it did not end a process that renders.
    jax.config.update("jax_enable_preemption_service", False)
    logging.getLogger("jax").setLevel(logging.ERROR)
    if not place.process:
        _check_port(place.coordinator)
    try:
        jax.distributed.initialize(
            place.coordinator,
            place.processes,
            place.process,
            cluster_detection_method="deactivate",
            initialization_timeout=seconds,
            heartbeat_timeout_seconds=_read_seconds("HEARTBEAT", HEARTBEAT_SECONDS),
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


class _Words:
    """Sentences for what jax says when the processes of a job do not come together."""

    def __init__(self, place: Place, seconds: int):
        self._place, self._seconds = place, seconds
        self.has_joined = False

    def is_loss(self, error) -> bool:
        """Whether an error tells that another process is lost."""
        kinds = (ValueError, jax.errors.JaxRuntimeError)
        text = str(error)
        has_code = re.match(r"[A-Z_]+: ", text)  # as jax's errors begin
        return bool(isinstance(error, kinds) and has_code and _LOSS.search(text))

    def explain(self, text: str) -> str:
        """The sentence for the words of jax's client or of a collective."""
        _, processes, process = self._place
        if not self.has_joined:
            return self._explain_start(text)
        silent = re.search(r"heartbeats\):\s*([\d, ]+)", text)
        if silent:
            lost = f"process {silent[1].strip()} has ended or says nothing"
        elif process and "CoordinationService" in text:
            lost = f"process 0, the coordinator at {self._place.coordinator}, has ended"
        else:
            lost = "another one has ended or cannot be reached"
        return (
            f"Process {process}: all {processes} processes of the job must go on, but "
            f"{lost}; look at what it said last, and {AGAIN}."
        )

    def _explain_start(self, text):
        address, processes, process = self._place
        if "DEADLINE_EXCEEDED" not in text:
            reason = re.search(r"absl::Status: (.*)", text)
            found = f"that failed ({reason[1] if reason else text.strip()[-300:]})"
        elif process:
            found = f"process 0 did not answer within {self._seconds} s"
        else:
            found = f"not all of them came within {self._seconds} s"
        return (
            f"Process {process}: the job at {address} must have {processes} processes, "
            f"but {found}; start all of them with the same --coordinator and "
            "--processes."
        )
