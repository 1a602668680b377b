"""Settings of the whole process, for doorways that compute for long."""

import contextlib
import ctypes


def keep_freed_memory():
    """Have glibc keep what a step frees for the next one.

    By default blocks of some megabytes go back to the system and come again page by
    page: 10,000 page faults and a quarter of the CPU time of a step of configs/car.py.
    Without glibc nothing happens.
    """
    with contextlib.suppress(OSError, AttributeError):  # another C library
        libc = ctypes.CDLL("libc.so.6")
        trim_threshold, mmap_max = -1, -4  # names in malloc.h
        libc.mallopt(mmap_max, 0)
        libc.mallopt(trim_threshold, 2**31 - 1)
