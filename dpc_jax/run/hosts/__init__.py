"""A run of several processes, on one host or many: the place of each, by its flags."""

from typing import NamedTuple


class Place(NamedTuple):
    """The place of a process in its job."""

    coordinator: str  # HOST:PORT at which process 0 is found
    processes: int  # how many the job has, at least 2
    process: int  # which of them this one is, from 0


def find_place(
    coordinator: str | None, processes: int | None, process: int | None
) -> Place | None:
    """The place that flags give a process; None for one on its own.

    Raises:
      ValueError: where the flags are not all given, or cannot be.
    """
    if coordinator is None and processes is None and process is None:
        return None
    if coordinator is None or processes is None or process is None:
        raise ValueError(
            "Expected --coordinator, --processes and --process together, but only some "
            "are given; give all three, or none for a process on its own."
        )
    host, _, port = coordinator.rpartition(":")
    if not host or not port.isdigit() or not 0 < int(port) < 65536:
        raise ValueError(
            f"--coordinator must be HOST:PORT of process 0, but it is {coordinator!r}; "
            "write for example --coordinator=node01:7777."
        )
    if not 0 <= process < processes:
        raise ValueError(
            f"--process must be 0 or more and below --processes = {processes}, but it "
            f"is {process}; give --processes of at least 1 and count from 0."
        )
    return Place(coordinator, processes, process) if processes > 1 else None
