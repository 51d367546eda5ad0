"""Durable ingest keeps up with the interface: a light run of ``python -m bench.bench_ingest``."""

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [pytest.mark.system, pytest.mark.slow, pytest.mark.timeout(90)]

#: half of the goal, for a machine that does other things at the same time
LEAST_RATIO = 1 / 6


def test_durable_ingest_reaches_a_sixth_of_the_rate_without_storage():
    root = Path(__file__).parents[2]
    command = [sys.executable, "-m", "bench.bench_ingest", "--repeats", "3", "--seconds", "0.7", "--connections", "4"]
    ran = subprocess.run(command, cwd=root, capture_output=True, text=True, timeout=80, check=False)
    print(ran.stdout)
    # 1 says that the goal was missed, which half of the goal is judged by here
    assert ran.returncode in (0, 1), ran.stderr
    ratio = float(ran.stdout.partition("ratio ")[2].partition(",")[0])
    assert ratio >= LEAST_RATIO
