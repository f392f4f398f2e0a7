"""How many cores there are to be used: by all that runs here, and by this process alone."""

import os
from pathlib import Path


def usable_cores() -> int:
    """Physical cores that this process may use: affinity and the container's quota are heeded."""
    cpus = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set(range(os.cpu_count() or 1))
    siblings = {text_of(f"/sys/devices/system/cpu/cpu{n}/topology/thread_siblings_list") or str(n) for n in cpus}
    quota = (text_of("/sys/fs/cgroup/cpu.max") or "max 1").split()
    most = int(quota[0]) // int(quota[1]) if quota[0].isdigit() else len(siblings)
    return max(1, min(len(siblings), most))


def own_cores() -> int:
    """Cores that this process may keep busy: a share of them where it is one of several workers."""
    told = os.environ.get("OMP_NUM_THREADS", "")
    return min(usable_cores(), int(told)) if told.isdigit() and int(told) > 0 else usable_cores()


def text_of(path: str) -> str:
    """What is in a small file of the system's; nothing where it cannot be read."""
    try:
        return Path(path).read_text().strip()
    except OSError:
        return ""
