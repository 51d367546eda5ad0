"""The service as a process of its own, started and ended by tests; spoken to over real sockets on 127.0.0.1."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import chaos_clients as chaos
import httpx
import pytest
from release_ground import seed_archive
from service_process import KEY, ServiceProcess, serving_on
from storage_trial import Trial

from service.pipeline.first_rows import compile_rows


@pytest.fixture(scope="session")
def service_process() -> type[ServiceProcess]:
    """Return the class of processes, for fixtures that outlive a test."""
    return ServiceProcess


#: starts a service on a database, with further arguments
StartService = Callable[..., ServiceProcess]
#: exit code and output of ``soo serve`` with each of some lists of arguments and environments
RefusedStarts = Callable[..., list[tuple[int, str]]]
#: one process for many starts that end before they serve: it takes a second to load what each of them needs
_STARTS = """
import json, sys
from typer.testing import CliRunner
from service.cli.app import app
for arguments, environment in json.load(sys.stdin):
    done = CliRunner().invoke(app, ["serve", *arguments], env=environment)
    print(json.dumps([done.exit_code, done.output]))
"""


@pytest.fixture(scope="session")
def compiled_environment() -> dict[str, str]:
    """Return an environment in which processes share what Python and numba compile; the filter is compiled."""
    compile_rows()
    return dict(os.environ)


@pytest.fixture(scope="session")
def serving(compiled_environment: dict[str, str]) -> Callable[..., AbstractContextManager[ServiceProcess]]:
    """Give a function that runs a service under the clock of the data, and fails where it logs a traceback."""

    def serve(database: Path, **settings: str) -> AbstractContextManager[ServiceProcess]:
        return serving_on(database, {**compiled_environment, **settings})

    return serve


@pytest.fixture(scope="module")
def service(serving: Any, request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """Give one service to the tests of a module, on an archive with the spacecraft of its ``CRAFTS``."""
    database = tmp_path_factory.mktemp("service") / "soo.db"
    seed_archive(f"sqlite:///{database}", *request.module.CRAFTS)
    with serving(database) as started:
        yield started


@pytest.fixture
def client(service: ServiceProcess) -> Iterator[httpx.Client]:
    """Give an administrator's client of the module's service."""
    with service.client() as opened:
        yield opened


@pytest.fixture
def start_service(tmp_path: Path, compiled_environment: dict[str, str], empty_database: Path) -> Iterator[StartService]:
    """Give a function that starts services; those still running at the end are killed.

    A service that is given no database of its own starts on one that is migrated and empty.
    """
    started: list[ServiceProcess] = []
    kept = tmp_path / "soo.db"

    def start(
        *arguments: str, database: Path | None = None, environment: dict[str, str] | None = None
    ) -> ServiceProcess:
        given = arguments or ("--port", "0", "--clock", "data")
        chosen = {"SOO_BOOTSTRAP_KEY": KEY} if environment is None else environment
        whole = {**compiled_environment, **chosen}
        if database is None and not kept.exists():
            shutil.copy(empty_database, kept)
        service = ServiceProcess(tmp_path, database or kept, list(given), whole)
        started.append(service)
        return service

    yield start
    for service in started:
        if service.process.poll() is None:
            service.process.kill()
        service.process.wait()


@pytest.fixture
def refused_starts(compiled_environment: dict[str, str]) -> RefusedStarts:
    """Give a function that starts services one after another, in one process, none of which can serve."""

    def start(*starts: tuple[list[str], dict[str, str]]) -> list[tuple[int, str]]:
        done = subprocess.run(
            [sys.executable, "-c", _STARTS],
            input=json.dumps(starts),
            env=compiled_environment,
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
        assert (done.returncode, done.stderr) == (0, "")
        ended = [tuple(json.loads(line)) for line in done.stdout.splitlines()]
        assert len(ended) == len(starts)
        assert all("Traceback" not in output for _, output in ended), ended
        return ended

    return start


@pytest.fixture
def spacecraft() -> dict[str, Any]:
    """Return the body of a simulated spacecraft."""
    return {
        "id": "sim-1",
        "name": "Simulated",
        "longitude_deg": 90.0,
        "simulated": True,
        "receiving_site": {"name": "Moscow", "latitude_deg": 55.7, "longitude_deg": 37.6, "height_m": 200.0},
        "inertia_kg_m2": [[2600, 0, 0], [0, 1400, 0], [0, 0, 2600]],
        "torque_limit_n_m": 0.05,
    }


@pytest.fixture
def carriers() -> list[dict[str, Any]]:
    """Return sixteen carriers."""
    return [
        {
            "id": f"c{k:02d}",
            "station": {"name": f"station {k}", "latitude_deg": 45.0 + k, "longitude_deg": 40.0 + 5 * k},
            "band": "Ku",
            "transponder": f"Ku{k // 4}",
            "uplink_hz": 14.0e9 + k * 2e6,
            "downlink_hz": 11.0e9 + k * 2e6,
            "bandwidth_hz": 1.25e6,
        }
        for k in range(16)
    ]


@pytest.fixture
def trial(
    start_service: StartService,
    spacecraft: dict[str, Any],
    carriers: list[dict[str, Any]],
    tmp_path: Path,
) -> Iterator[Callable[..., Trial]]:
    """Give a maker of trials."""

    def make(**options: Any) -> Trial:
        made.append(Trial(start_service, chaos, spacecraft, carriers, tmp_path, **options))
        return made[-1]

    made: list[Trial] = []
    yield make
    for one in made:
        for client in one.clients:
            client.stop()
        one.client.close()
