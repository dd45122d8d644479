"""How much memory a batch takes, and how many parts it may therefore work on at once.

A worker holds one picture with what the search for segments makes of it, and the results of its
part. Measured (benchmarks/batch_frames.py): BYTES_PER_PIXEL, and BASE_BYTES of the program with its
compiled kernels.
"""

import os

from trinoc.geometry import Rig

BASE_BYTES = 900_000_000
BYTES_PER_PIXEL = 160
# Parts begun or finished and not yet written, for each worker: one to go on with.
PARTS_PER_WORKER = 2


def threads_within(memory_bytes: float, rig: Rig, wanted: int) -> int:
    """How many threads may look for segments at once; at least one."""
    pixels = max(width * height for width, height in (rig[n].image_size_px for n in rig.names))
    room = (memory_bytes - BASE_BYTES) / (BYTES_PER_PIXEL * pixels)
    return max(1, min(wanted, int(room)))


def half_of_the_machine() -> float:
    """Half of the machine's memory in bytes; infinite where it does not say."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2
    except (AttributeError, OSError, ValueError):
        return float("inf")


def resident_bytes() -> int:
    """Memory of this process; 0 where the system does not say."""
    try:
        with open("/proc/self/statm", encoding="ascii") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError):
        return 0
