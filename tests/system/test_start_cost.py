"""Cost of a start: processor time of a command, memory, and modules that a start must not load.

The bound of memory is that of ``bench/bench_start.py``, half as much again; the bench tells the exact figures and the
time.
"""

import os
import statistics
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.system

#: each costs a tenth of a second and more, or ten megabytes and more
COSTLY = ("pyarrow", "matplotlib", "scipy", "numba", "prometheus_client", "httpx", "skyfield", "pyvisa")
MAX_RSS_MB = 225.0
#: modules that no command needs before it begins its work
WORKING = (*COSTLY, "numpy", "pydantic_settings", "fastapi", "sqlalchemy", "rich", "ssl", "sqlite3", "asyncio")
#: processor time of a start over that of ``import typer``; typer itself, which reads options by pydantic, takes 2.4
MAX_START_RATIO = 3.0
STARTS = (
    "service --help",
    "service serve --help",
    "service demo --help",
    "service acquire --help",
    "service keys list --service none",
    "service audit verify --help",
    "service study closed-loop --help",
    "analyzer_sim --help",
)
_RUNS = 7
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")


def test_costly_modules_are_not_loaded_by_a_service_without_work():
    code = (
        "import sys; import service.__main__, service.composition.bootstrap, service.cli.administration.serve;"
        "import service.api.server_process;"
        f"print(*[name for name in {COSTLY!r} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout.split() == []


def test_no_command_loads_what_it_works_with_before_it_begins():
    code = (
        "import sys, typer, service.__main__, analyzer_sim.__main__\n"
        "from service.cli.app import app\n"
        "def walk(group):\n"
        "    for command in group.commands.values():\n"
        "        walk(command) if hasattr(command, 'commands') else print(command.name)\n"
        "walk(typer.main.get_command(app))\n"
        f"print(*[name for name in {WORKING!r} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    *names, loaded = done.stdout.splitlines()
    assert len(names) > 20
    assert loaded == ""


def processor_s(*arguments):
    """Return the processor time of an interpreter with these arguments."""
    silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "stdin": subprocess.DEVNULL}
    # without a key an operator's command ends before it asks the service
    environment = {name: value for name, value in os.environ.items() if not name.startswith("SOO_")}
    process = subprocess.Popen([sys.executable, *arguments], env=environment, **silent)
    _, _, usage = os.wait4(process.pid, 0)
    process.returncode = 0
    return usage.ru_utime + usage.ru_stime


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "wait4"), reason="the system does not tell what a process took")
def test_a_command_starts_in_three_times_the_import_of_typer():
    taken = {words: [] for words in STARTS}
    reference = []
    for _ in range(_RUNS):
        reference.append(processor_s("-c", "import typer"))
        for words, times in taken.items():
            times.append(processor_s("-m", *words.split()))
    typer_s = statistics.median(reference)
    ratios = {words: statistics.median(times) / typer_s for words, times in taken.items()}
    for words, ratio in ratios.items():
        print(f"{ratio:.2f} {words}")
    assert max(ratios.values()) <= MAX_START_RATIO


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="the system does not tell what a process takes")
def test_start_and_idle_service_stay_small(start_service):
    # on a database that is there already
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
