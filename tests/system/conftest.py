"""The service as a process of its own, started and ended by tests; spoken to over real sockets on 127.0.0.1."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import chaos_clients as chaos
import httpx
import pytest
from release_ground import seed_archive
from storage_trial import Trial

KEY = "a-key-for-tests-only"
#: the compiler would take longer than the tests of a module
PLAIN = {"SOO_BOOTSTRAP_KEY": KEY, "SOO_KERNELS": "numpy", "SOO_ACCESS_LOG": "false"}
#: a start takes 2 s alone; the machine may be busy with other tests
START_TIMEOUT_S = 120.0


class ServiceProcess:
    """One ``soo serve``; what it writes goes to files, so that no pipe fills."""

    def __init__(self, folder: Path, database: Path, arguments: list[str], environment: dict[str, str]) -> None:
        number = len(list(folder.glob("service-*.out")))
        self.output, self.log = folder / f"service-{number}.out", folder / f"service-{number}.err"
        command = [sys.executable, "-m", "service", "serve", "--database", f"sqlite:///{database}", *arguments]
        with self.output.open("wb") as output, self.log.open("wb") as log:
            self.process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=output, stderr=log, env=environment
            )

    def await_announcement(self) -> dict[str, Any]:
        """Return the line that tells where it listens."""
        deadline = time.monotonic() + START_TIMEOUT_S
        while time.monotonic() < deadline:
            text = self.output.read_text()
            if text.endswith("\n"):
                return dict(json.loads(text.splitlines()[0]))
            if self.process.poll() is not None:
                break
            time.sleep(0.02)
        raise AssertionError(f"no announcement, exit code {self.process.poll()}:\n{self.log.read_text()}")

    @property
    def url(self) -> str:
        """Address, known once it listens."""
        return str(self.await_announcement()["url"])

    def client(self) -> httpx.Client:
        """Return a client with the key of the tests."""
        return httpx.Client(
            base_url=self.url, headers={"Authorization": f"Bearer {KEY}"}, timeout=120.0, trust_env=False
        )

    def end(self, number: signal.Signals = signal.SIGTERM, timeout_s: float = 120.0) -> tuple[int, float]:
        """Send a signal and return exit code and seconds until the end."""
        began = time.monotonic()
        self.process.send_signal(number)
        return self.process.wait(timeout_s), time.monotonic() - began

    def written(self) -> str:
        """Return all that it wrote so far."""
        return self.output.read_text() + self.log.read_text()


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
    """Return an environment in which processes share what Python and numba compile."""
    return dict(os.environ)


@pytest.fixture(scope="session")
def serving(compiled_environment: dict[str, str]) -> Callable[..., AbstractContextManager[ServiceProcess]]:
    """Give a function that runs a service under the clock of the data, and fails where it logs a traceback."""

    @contextmanager
    def serve(database: Path, **settings: str) -> Iterator[ServiceProcess]:
        environment = {**compiled_environment, **PLAIN, **settings}
        service = ServiceProcess(database.parent, database, ["--port", "0", "--clock", "data"], environment)
        try:
            yield service
            said = service.written()
            assert "Traceback" not in said, said[said.index("Traceback") - 500 :][:5000]
        finally:
            service.process.kill()
            service.process.wait()

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
