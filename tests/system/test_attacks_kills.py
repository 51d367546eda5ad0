"""A service ends at work: the next one fails its calibration and goes on with its replay; no process outlives it."""

import os
import signal
from pathlib import Path
from typing import Any

import chaos_clients as chaos
import httpx
import pytest
from child_processes import children_of
from waiting import wait_until

from db.storage import SqlStorage
from service.records.calibration import (
    Alignment,
    CalibrationMethod,
    CalibrationRequest,
    CalibrationResult,
    Observability,
    Window,
)
from service.records.catalogue import Ephemeris
from service.records.levels.attitude import NO_ANGLES, Axes

pytestmark = [pytest.mark.system, pytest.mark.slow, pytest.mark.timeout(600)]

SC = "/api/v1/spacecraft/sim-1"
S = 1_000_000
#: 2026-11-21T00:00:00Z
START_US = 1_795_219_200 * S
DAY_US = 86_400 * S
CALIBRATION = {
    "quiet": {"start": "2026-11-17T00:00:00Z", "stop": "2026-11-19T00:00:00Z"},
    "turns": {"start": "2026-11-19T00:00:00Z", "stop": "2026-11-20T00:00:00Z"},
    "method": "paper",
}
REPLAY = {"start": "2026-11-21T00:00:00Z", "stop": "2026-11-21T01:00:00Z"}


def align(database: Path) -> None:
    """Store what a calibration and a replay start from."""
    storage = SqlStorage(f"sqlite:///{database}")
    nodes_us = tuple(START_US + k * 86_328 * S for k in range(-5, 2))
    storage.catalogue.put_ephemeris("sim-1", Ephemeris(0, nodes_us, 86_328.0, nodes_us[0], nodes_us[-1], "nodes"))
    results, zero = storage.results, Axes(0.0, 0.0, 0.0)
    request = CalibrationRequest(Window(0, 10), Window(10, 20), CalibrationMethod.PAPER)
    draft = results.add_calibration("sim-1", request, 1, 1, 5, "engineer")
    results.finish_calibration("sim-1", draft.id, CalibrationResult((), Observability(3.0, zero, zero), {}, ()), None)
    results.add_alignment("sim-1", Alignment(0, START_US, zero, NO_ANGLES, 1, "manual", 6, "approver", ()))
    storage.close()


def workers_of(service_id: int) -> set[int]:
    """Return the processes that compute for a service."""
    return {child for child in children_of(service_id) if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes()}


def has_ended(process_id: int) -> bool:
    """Return whether a process is over, collected by its new parent or not."""
    stat = Path(f"/proc/{process_id}/stat")
    try:
        return stat.read_text().rpartition(")")[2].split()[0] == "Z"
    except (FileNotFoundError, ProcessLookupError):
        return True


def begin_work(client: httpx.Client, service_id: int) -> tuple[set[int], dict[str, Any], dict[str, Any]]:
    """Start a calibration and a replay while the worker stands still; return the worker and both."""
    # the first calibration, which fails for want of rows, starts the worker
    failed = client.post(f"{SC}/calibrations", json=CALIBRATION).json()
    wait_until(lambda: job_of(client, failed)["state"] == "failed", "a calibration of nothing does not end")
    first = client.post(f"{SC}/replays", json=REPLAY).json()
    wait_until(lambda: job_of(client, first)["state"] == "done", "a replay of nothing does not end")
    workers = workers_of(service_id)
    assert len(workers) == 1
    for worker in workers:
        os.kill(worker, signal.SIGSTOP)
    calibration = client.post(f"{SC}/calibrations", json=CALIBRATION)
    replay = client.post(f"{SC}/replays", json=REPLAY)
    assert (calibration.status_code, replay.status_code) == (202, 202), calibration.text + replay.text
    wait_until(lambda: job_of(client, calibration.json())["state"] == "running", "the calibration does not begin")
    return workers, calibration.json(), replay.json()


def job_of(client: httpx.Client, started: dict[str, Any]) -> dict[str, Any]:
    """Return the job of what was started."""
    return dict(client.get(f"/api/v1/jobs/{started['job']}").json())


@pytest.mark.parametrize("number", [signal.SIGKILL, pytest.param(signal.SIGTERM, marks=pytest.mark.nightly)])
def test_an_ended_service_goes_on_with_its_calibration_and_its_replay(
    start_service, spacecraft, carriers, tmp_path, number
):
    settings = {"SOO_BOOTSTRAP_KEY": "a-key-for-tests-only"}
    options = ("--port", "0", "--clock", "data")
    service = start_service(*options, environment=settings)
    with service.client() as client:
        chaos.set_up(client, spacecraft, carriers)
    service.end(timeout_s=120)
    align(tmp_path / "soo.db")
    service = start_service(*options, environment=settings)
    with service.client() as client:
        client.timeout = 120
        workers, calibration, replay = begin_work(client, service.process.pid)
        reported = client.get(f"{SC}/calibrations/{calibration['id']}").json()
        assert reported["state"] == "draft"
        refused = client.get(f"{SC}/attitude/history", params={"version": replay["version"]})
        assert (refused.status_code, refused.json()["code"]) == (409, "replay.unfinished")
    service.end(number, timeout_s=120)
    if number == signal.SIGKILL:
        for worker in workers:
            os.kill(worker, signal.SIGCONT)
    wait_until(lambda: all(map(has_ended, workers)), "a worker outlives its service")
    service = start_service(*options, environment=settings)
    with service.client() as client:
        wait_until(lambda: job_of(client, calibration)["state"] == "failed", "the calibration does not go on")
        reported = client.get(f"{SC}/calibrations/{calibration['id']}").json()
        assert reported["state"] == "failed"
        for error in (reported["error"], job_of(client, calibration)["error"]):
            assert "measurements" in error, "for want of rows, as the first one"
        wait_until(lambda: job_of(client, replay)["state"] == "done", "the replay does not go on")
        assert client.get(f"{SC}/attitude/history", params={"version": replay["version"]}).json()["rows"] == []
        assert client.get(f"{SC}/calibrations/1").json()["state"] == "draft"
        refused = client.post(f"{SC}/calibrations/{calibration['id']}:activate")
        assert (refused.status_code, refused.json()["code"]) == (409, "calibration.unfinished")
