"""Cost of a start: memory, and modules that a service without work must not load.

The bound is that of ``bench/bench_start.py``, half as much again; the bench tells the exact figures and the time.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.system

#: each costs a tenth of a second and more, or ten megabytes and more
COSTLY = ("pyarrow", "alembic", "matplotlib", "scipy", "numba", "prometheus_client", "httpx", "skyfield", "pyvisa")
MAX_RSS_MB = 225.0
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")


def test_costly_modules_are_not_loaded_by_a_service_without_work():
    code = (
        "import sys; import service.__main__, service.bootstrap, service.cli.administration.serve;"
        "import service.api.server_process;"
        f"print(*[name for name in {COSTLY!r} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout.split() == []


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="the system does not tell what a process takes")
def test_start_and_idle_service_stay_small(start_service):
    service = start_service()
    service.await_announcement()
    service.end()
    # the second start: the first one made the database
    service = start_service()
    with service.client() as client:
        assert client.get("/readyz").status_code == 200
        pid = service.process.pid
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        cpu_s = (int(fields[11]) + int(fields[12])) / _TICKS_PER_S
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
        rss_mb = int(next(line.split()[1] for line in lines if line.startswith("VmRSS"))) / 1024
    print(f"{cpu_s:.2f} s of processor time, {rss_mb:.0f} MB")
    assert rss_mb < MAX_RSS_MB
