"""Memory, processor time and open files of the process, as the operating system reports them."""

import os
import resource
import sys
from pathlib import Path
from typing import NamedTuple

_STATUS = Path("/proc/self/statm")
_STAT = Path("/proc/self/stat")
#: places of the start in that file behind the name, which may hold spaces
_START_FIELD = 19
#: descriptors above which none are asked for: more than any number of connections that is served
_ENOUGH_DESCRIPTORS = 65_536


class ProcessMetrics(NamedTuple):
    """Figures of this process."""

    #: memory in use, bytes; the greatest so far where the system does not tell the present
    rss_bytes: int
    cpu_s: float
    #: None where the system does not tell
    open_files: int | None
    threads: int | None


def raised_descriptor_limit() -> int:
    """Raise the limit of open files and sockets as far as the system lets this process; return it."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = _ENOUGH_DESCRIPTORS if hard == resource.RLIM_INFINITY else min(hard, _ENOUGH_DESCRIPTORS)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
    return wanted


def process_statistics() -> ProcessMetrics:
    """Return the figures of this process."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    try:
        rss_bytes = int(_STATUS.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
        threads = int(_STAT.read_text().rpartition(")")[2].split()[_START_FIELD - 2])
        open_files = len(os.listdir("/proc/self/fd"))  # noqa: PTH208 - counts, paths are of no use
    except OSError:
        unit_bytes = 1 if sys.platform == "darwin" else 1024
        return ProcessMetrics(used.ru_maxrss * unit_bytes, used.ru_utime + used.ru_stime, None, None)
    return ProcessMetrics(rss_bytes, used.ru_utime + used.ru_stime, open_files, threads)
