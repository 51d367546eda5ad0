"""Documents under test, and the service as a process of its own for those that talk to it."""

import json
import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[2]
KEY = "a-key-for-the-documents"


class RunningService(NamedTuple):
    """Address of a service and what a shell needs to reach it."""

    url: str
    environment: dict[str, str]


@pytest.fixture(scope="session")
def root() -> Path:
    """Return the root of the repository."""
    return ROOT


@pytest.fixture(scope="session")
def documents() -> list[Path]:
    """Return every document written for people."""
    return [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))]


@pytest.fixture
def service(tmp_path: Path) -> Iterator[RunningService]:
    """Run ``soo serve`` on a free port with the clock of the data."""
    if shutil.which("bash") is None or shutil.which("curl") is None:
        pytest.skip("bash and curl are needed to run the tutorial's blocks")
    scripts = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    own = {name: value for name, value in os.environ.items() if not name.startswith("SOO_")}
    environment = {
        **own,
        "PATH": scripts,
        "PYTHONPATH": str(ROOT),
        "no_proxy": "127.0.0.1",
        "OPENBLAS_NUM_THREADS": "1",
        "SOO_BOOTSTRAP_KEY": KEY,
        "SOO_KEY": KEY,
    }
    command = [sys.executable, "-m", "service", "serve", "--port", "0", "--clock", "data"]
    database = f"sqlite:///{tmp_path / 'archive.db'}"
    log_path = tmp_path / "service.log"
    with log_path.open("wb") as log:
        process = subprocess.Popen(
            [*command, "--database", database], stdout=subprocess.PIPE, stderr=log, env=environment, cwd=tmp_path
        )
    watchdog = threading.Timer(580.0, process.kill)
    watchdog.start()
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line, f"the service did not start:\n{log_path.read_text()}"
        announcement: dict[str, Any] = json.loads(line)
        api = announcement["api"]
        shell = {"API": api, "SC": f"{api}/spacecraft/yamal-202", "AUTH": f"Authorization: Bearer {KEY}"}
        yield RunningService(announcement["url"], {**environment, **shell, "SOO_URL": announcement["url"]})
    finally:
        watchdog.cancel()
        process.terminate()
        process.communicate(timeout=120)
