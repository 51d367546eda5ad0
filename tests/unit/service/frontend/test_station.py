"""A station reports its links, obeys orders, ends in order, and never runs on in half."""

import json
import logging
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from spooled_rows import spool
from steady_world import CARRIERS, steady_task

from service.client.backoff import Backoff
from service.client.service_client import ServiceClient
from service.frontend.acquisition.states import AcquisitionEvent, AcquisitionSettings, AcquisitionState
from service.frontend.link_report import LinkReporter
from service.frontend.station import MeasuringStation, StationError
from service.frontend.upload.uploader import UploadSettings

Answer = Callable[[httpx.Request], httpx.Response]


class Service:
    """A service that answers reports as it is told, and keeps them."""

    def __init__(self) -> None:
        self.reports: list[dict[str, Any]] = []
        self.wishes: dict[str, tuple[bool, int]] = {}
        self.answer: Answer = self.agree

    def agree(self, _: httpx.Request) -> httpx.Response:
        links = [each["id"] for each in self.reports[-1]["links"]]
        wishes = {name: self.wishes.get(name, (True, 0)) for name in links}
        return httpx.Response(
            200, json={"links": [{"id": name, "enabled": wish[0], "reset": wish[1]} for name, wish in wishes.items()]}
        )

    def handle(self, request: httpx.Request) -> httpx.Response:
        self.reports.append(json.loads(request.content))
        return self.answer(request)


@pytest.fixture
def made(tmp_path: Path) -> Iterator[tuple[Service, MeasuringStation, LinkReporter]]:
    """Give a service, a station and its reporter."""
    service = Service()
    client = ServiceClient("http://service", "key", retries=0, http=httpx.MockTransport(service.handle))
    with spool(tmp_path) as rows:
        station = MeasuringStation(
            steady_task(),
            AcquisitionSettings("TCPIP::analyzer::5025::SOCKET", 5.0),
            UploadSettings("sc", "sa-1"),
            client,
            rows,
            lambda: 0,
        )
        yield service, station, LinkReporter(client, "front-end.here", [station])


def test_a_report_tells_state_counters_and_warnings(made: tuple[Service, MeasuringStation, LinkReporter]) -> None:
    service, station, reporter = made
    counters = station.acquisition.counters
    counters.rows, counters.good_rows, counters.last_good_us = 7, 6, 1_795_230_152_000_000
    reporter.report()
    front_end, analyzer = service.reports[0]["links"]
    assert (front_end["id"], front_end["kind"], front_end["state"]) == ("front-end.here", "front_end", "RUNNING")
    assert (analyzer["id"], analyzer["kind"], analyzer["state"]) == ("sc.sa-1", "analyzer", "CONNECT")
    assert (analyzer["spacecraft_id"], analyzer["source"]) == ("sc", "sa-1")
    assert (analyzer["counters"]["rows"], analyzer["counters"]["good_rows"]) == (7, 6)
    assert analyzer["last_good"] == "2026-11-21T03:02:32.000000Z"
    assert all(isinstance(value, int) for value in analyzer["counters"].values())
    assert analyzer["warnings"] == []


def test_orders_reach_the_acquisition(made: tuple[Service, MeasuringStation, LinkReporter]) -> None:
    service, station, reporter = made
    orders = station.acquisition.orders
    reporter.report()
    assert orders.next(AcquisitionState.MEASURE) is None
    service.wishes["sc.sa-1"] = (False, 0)
    reporter.report()
    assert orders.next(AcquisitionState.MEASURE) is AcquisitionEvent.DISABLE
    service.wishes["sc.sa-1"] = (True, 2)
    reporter.report()
    assert orders.next(AcquisitionState.DISABLED) is AcquisitionEvent.ENABLE
    reporter.report()
    assert service.reports[-1]["links"][1]["reset_seen"] == 2


def test_a_reset_of_the_front_end_is_one_of_all_its_analyzers(
    made: tuple[Service, MeasuringStation, LinkReporter],
) -> None:
    service, station, reporter = made
    reporter.report()
    service.wishes["front-end.here"] = (True, 1)
    reporter.report()
    assert station.acquisition.orders.next(AcquisitionState.MEASURE) is AcquisitionEvent.RESET
    reporter.report()
    assert station.acquisition.orders.next(AcquisitionState.MEASURE) is None


def test_resets_of_an_earlier_start_are_not_carried_out_again(
    made: tuple[Service, MeasuringStation, LinkReporter],
) -> None:
    service, station, reporter = made
    service.wishes = {"front-end.here": (True, 3), "sc.sa-1": (True, 2)}
    reporter.report()
    assert station.acquisition.orders.next(AcquisitionState.MEASURE) is None
    service.wishes["sc.sa-1"] = (True, 3)
    reporter.report()
    assert station.acquisition.orders.next(AcquisitionState.MEASURE) is AcquisitionEvent.RESET


def test_an_end_in_good_order_is_the_last_word(made: tuple[Service, MeasuringStation, LinkReporter]) -> None:
    service, _, reporter = made
    reporter.start()
    reporter.stop()
    (report,) = service.reports
    assert [link["state"] for link in report["links"]] == ["STOPPED", "STOPPED"]


def raises(error: Exception) -> Answer:
    """Return an answer that is no answer."""

    def answer(_: httpx.Request) -> httpx.Response:
        raise error

    return answer


@pytest.mark.parametrize(
    "answer",
    [
        raises(httpx.ConnectError("refused")),
        lambda _: httpx.Response(503, json={"code": "storage.unavailable", "detail": "later"}),
        lambda _: httpx.Response(401, json={"code": "key.unknown", "detail": "who"}),
        lambda _: httpx.Response(200, json={}),
        lambda _: httpx.Response(200, json={"links": [{"id": "sc.sa-1"}]}),
        lambda _: httpx.Response(200, json={"links": None}),
        lambda _: httpx.Response(200, content=b"<html>"),
    ],
)
def test_a_service_that_is_away_changes_nothing_and_is_told_of_once(
    made: tuple[Service, MeasuringStation, LinkReporter], answer: Answer, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, logger="service.frontend.link_report")
    service, station, reporter = made
    service.answer = answer
    reporter.report()
    reporter.report()
    assert station.acquisition.orders.next(AcquisitionState.MEASURE) is None
    assert caplog.text.count("link reports cannot be sent") == 1
    service.answer = service.agree
    reporter.report()
    assert "link reports are sent again" in caplog.text


@pytest.fixture
def station_made(tmp_path: Path) -> Iterator[MeasuringStation]:
    """Give a station whose service knows the plan."""
    plan = {"plan_id": 1, "carriers": [{"id": name} for name in CARRIERS]}
    http = httpx.MockTransport(lambda _: httpx.Response(200, json=plan))
    client = ServiceClient("http://service", "key", retries=0, http=http)
    with spool(tmp_path) as rows:
        yield MeasuringStation(
            steady_task(),
            AcquisitionSettings("TCPIP::analyzer::5025::SOCKET", 0.0),
            UploadSettings("sc", "sa-1", drain_s=0.2),
            client,
            rows,
            lambda: 0,
            lambda: Backoff(first_s=0.001, limit_s=0.002),
        )


def test_a_stop_ends_both_threads(station_made: MeasuringStation, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(station_made.acquisition, "run", lambda: station_made._stop.wait(120.0))
    threading.Timer(0.05, station_made.stop).start()
    summary = station_made.run()
    assert summary.undelivered == 0
    assert summary.acquisition.rows == 0


@pytest.mark.parametrize("part", ["acquisition", "uploader"])
def test_a_thread_that_dies_takes_the_station_down(
    station_made: MeasuringStation, monkeypatch: pytest.MonkeyPatch, part: str
) -> None:

    def die(*_: Any) -> None:
        raise MemoryError("no room")

    monkeypatch.setattr(station_made.acquisition, "run", lambda: station_made._stop.wait(120.0))
    target = station_made.acquisition if part == "acquisition" else station_made.uploader
    monkeypatch.setattr(target, "run", die)
    with pytest.raises(StationError, match=f"{part} sc.sa-1 failed: MemoryError no room"):
        station_made.run()
