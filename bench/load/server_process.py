"""A service of a benchmark as a process of its own."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

#: clock ticks of the processor times in /proc
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")
_KB = 1024


class ServedProcess(NamedTuple):
    """A running service."""

    url: str
    pid: int
    #: from the start of the process to the announcement of its address, s
    start_s: float

    def cpu_s(self) -> float:
        """Return the processor time that it took."""
        fields = Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / _TICKS_PER_S

    def rss_bytes(self) -> int:
        """Return the memory that it has in use."""
        lines = Path(f"/proc/{self.pid}/status").read_text().splitlines()
        return _KB * int(next(line.split()[1] for line in lines if line.startswith("VmRSS")))


@contextmanager
def served(archive: str, url: str, key: str) -> Iterator[ServedProcess]:
    """Start the server of the ingest benchmark over an archive, durable or none, and end it."""
    command = [sys.executable, "-m", "bench.load.ingest_server", "--archive", archive, "--database", url]
    with running(command, key) as process:
        yield process


@contextmanager
def running(command: list[str], key: str, announced: str = "url", **environment: str) -> Iterator[ServedProcess]:
    """Start a service that announces its address, or its name as an estimator, in JSON, and end it."""
    whole = {**os.environ, "SOO_BOOTSTRAP_KEY": key, "OPENBLAS_NUM_THREADS": "1", "SOO_ACCESS_LOG": "false"}
    began_s = time.perf_counter()
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env={**whole, **environment}
    ) as process:
        try:
            assert process.stdout is not None
            url = str(json.loads(process.stdout.readline())[announced])
            yield ServedProcess(url, process.pid, time.perf_counter() - began_s)
        finally:
            process.terminate()
