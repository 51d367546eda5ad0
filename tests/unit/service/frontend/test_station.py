"""A station ends in order, and never runs on in half."""

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from spooled_rows import spool

from service.client.backoff import Backoff
from service.client.service_client import ServiceClient
from service.frontend.acquisition.settings import AcquisitionSettings
from service.frontend.measurement_task import MeasurementTask, parse_task
from service.frontend.station import MeasuringStation, StationError
from service.frontend.upload.uploader import UploadSettings


def task() -> MeasurementTask:
    """Return a task of one carrier."""
    return parse_task(
        b'{"id":"t","sweeps":[{"id":"a","start_hz":950e6,"stop_hz":990e6,"rbw_hz":40e3,"points":2001,"time_s":2}],'
        b'"carriers":[{"id":"c00","sweep":"a","fc_hz":960e6,"symbol_rate":1e6,"integ_bw_hz":1.25e6,'
        b'"noise":[[951e6,954e6]]}]}'
    )[0]


@pytest.fixture
def made(tmp_path: Path) -> Iterator[MeasuringStation]:
    """Give a station whose service knows the plan."""
    plan = {"plan_id": 1, "carriers": [{"id": "c00"}]}
    http = httpx.MockTransport(lambda _: httpx.Response(200, json=plan))
    client = ServiceClient("http://service", "key", retries=0, http=http)
    with spool(tmp_path) as rows:
        yield MeasuringStation(
            task(),
            AcquisitionSettings("TCPIP::analyzer::5025::SOCKET", 0.0),
            UploadSettings("sc", "sa-1", drain_s=0.2),
            client,
            rows,
            lambda: 0,
            lambda: Backoff(first_s=0.001, limit_s=0.002),
        )


def test_a_stop_ends_both_threads(made: MeasuringStation, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(made.acquisition, "run", lambda: made._stop.wait(120.0))
    threading.Timer(0.05, made.stop).start()
    summary = made.run()
    assert summary.undelivered == 0
    assert summary.acquisition.rows == 0


@pytest.mark.parametrize("part", ["acquisition", "uploader"])
def test_a_thread_that_dies_takes_the_station_down(
    made: MeasuringStation, monkeypatch: pytest.MonkeyPatch, part: str
) -> None:

    def die(*_: Any) -> None:
        raise MemoryError("no room")

    monkeypatch.setattr(made.acquisition, "run", lambda: made._stop.wait(120.0))
    target = made.acquisition if part == "acquisition" else made.uploader
    monkeypatch.setattr(target, "run", die)
    with pytest.raises(StationError, match=f"{part} sc.sa-1 failed: MemoryError no room"):
        made.run()
