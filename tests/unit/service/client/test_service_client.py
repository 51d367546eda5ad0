"""Methods of the client meet the contract's paths and bodies."""

import json
from collections.abc import Callable
from itertools import count
from types import SimpleNamespace
from typing import Any

import httpx
import pytest

from service.client.service_client import JobFailedError, ServiceClient, epoch_text


def client(handle: Callable[[httpx.Request], httpx.Response]) -> ServiceClient:
    """Return a client of a scripted service."""
    return ServiceClient("http://service", "key", http=httpx.MockTransport(handle))


@pytest.mark.parametrize(
    ("call", "method", "path", "body"),
    [
        (lambda c: c.create_spacecraft({"id": "x"}), "POST", "/spacecraft", {"id": "x"}),
        (lambda c: c.spacecraft("x"), "GET", "/spacecraft/x", None),
        (lambda c: c.put_carriers("x", [{"id": "c"}]), "PUT", "/spacecraft/x/carriers", {"carriers": [{"id": "c"}]}),
        (lambda c: c.carriers("x"), "GET", "/spacecraft/x/carriers", None),
        (lambda c: c.put_ephemeris("x", {"tle": []}), "PUT", "/spacecraft/x/ephemeris", {"tle": []}),
        (
            lambda c: c.post_measurements("x", 3, [{"epoch": "e"}], source="s", first_seq=2),
            "POST",
            "/spacecraft/x/measurements:batch",
            {"plan_id": 3, "measurements": [{"epoch": "e"}], "source": "s", "first_seq": 2},
        ),
        (
            lambda c: c.post_measurements("x", 3, []),
            "POST",
            "/spacecraft/x/measurements:batch",
            {"plan_id": 3, "measurements": []},
        ),
        (
            lambda c: c.post_references("x", "other", []),
            "POST",
            "/spacecraft/x/attitude-references:batch",
            {"source": "other", "references": []},
        ),
        (
            lambda c: c.post_traces("x", "sa-1", [{"epoch": "e"}]),
            "POST",
            "/spacecraft/x/traces",
            {"source": "sa-1", "traces": [{"epoch": "e"}]},
        ),
        (lambda c: c.post_corrections("x", []), "POST", "/spacecraft/x/corrections:batch", {"corrections": []}),
        (
            lambda c: c.post_weather("x", "radar", []),
            "POST",
            "/spacecraft/x/weather:batch",
            {"source": "radar", "reports": []},
        ),
        (
            lambda c: c.post_polarization("x", "p", []),
            "POST",
            "/spacecraft/x/polarization:batch",
            {"source": "p", "records": []},
        ),
        (lambda c: c.post_operation("x", {"kind": "other"}), "POST", "/spacecraft/x/operations", {"kind": "other"}),
        (lambda c: c.start_calibration("x", {}), "POST", "/spacecraft/x/calibrations", {}),
        (lambda c: c.calibration("x", 7), "GET", "/spacecraft/x/calibrations/7", None),
        (lambda c: c.activate_calibration("x", 7), "POST", "/spacecraft/x/calibrations/7:activate", None),
        (lambda c: c.align("x", {"source": "manual"}), "POST", "/spacecraft/x/alignments", {"source": "manual"}),
        (lambda c: c.about(), "GET", "/about", None),
        (lambda c: c.samples("x", ["roll_deg"]), "GET", "/spacecraft/x/samples", None),
        (lambda c: c.timeline("x"), "GET", "/spacecraft/x/timeline", None),
        (lambda c: c.status("x"), "GET", "/spacecraft/x/status", None),
        (lambda c: c.measurements("x"), "GET", "/spacecraft/x/measurements", None),
        (lambda c: c.attitude("x", "paper"), "GET", "/spacecraft/x/attitude", None),
        (lambda c: c.torques("x"), "GET", "/spacecraft/x/torques", None),
        (
            lambda c: c.prepare_torques("x", "why", start=0, duration_s=60.0),
            "POST",
            "/spacecraft/x/torques:prepare",
            {
                "reason": "why",
                "dry_run": False,
                "start": "1970-01-01T00:00:00.000000Z",
                "duration_s": 60.0,
                "max_torque_n_m": None,
            },
        ),
        (lambda c: c.command("x", 7), "GET", "/spacecraft/x/torques/7", None),
        (
            lambda c: c.confirm_torques("x", 7, "ab", "seen"),
            "POST",
            "/spacecraft/x/torques/7:confirm",
            {"digest": "ab", "comment": "seen"},
        ),
        (lambda c: c.cancel_torques("x", 7), "POST", "/spacecraft/x/torques/7:cancel", {"comment": ""}),
        (lambda c: c.report_torques("x", 7, "sent"), "POST", "/spacecraft/x/torques/7:sent", {}),
        (
            lambda c: c.report_torques("x", 7, "executed", executed_until=0),
            "POST",
            "/spacecraft/x/torques/7:executed",
            {"executed_until": "1970-01-01T00:00:00.000000Z"},
        ),
        (lambda c: c.uplink("x", 7), "GET", "/spacecraft/x/torques/7/uplink", None),
        (lambda c: c.attitude_uplink("x"), "GET", "/spacecraft/x/attitude/uplink", None),
        (lambda c: c.control("x"), "GET", "/spacecraft/x/control", None),
        (lambda c: c.order_control("x", "arm"), "POST", "/spacecraft/x/control:arm", {"comment": ""}),
        (
            lambda c: c.engage_control("x", 0, {"impulse_n_m_s": 0.01}),
            "POST",
            "/spacecraft/x/control:engage",
            {"until": "1970-01-01T00:00:00.000000Z", "envelope": {"impulse_n_m_s": 0.01}, "comment": ""},
        ),
        (
            lambda c: c.check_sign("x", "roll"),
            "POST",
            "/spacecraft/x/control:sign-check",
            {"axis": "roll", "comment": ""},
        ),
        (lambda c: c.start_closed_loop({"seed": 2}), "POST", "/analyses/closed-loop", {"seed": 2}),
        (lambda c: c.closed_loop("j-1"), "GET", "/analyses/closed-loop/j-1", None),
        (lambda c: c.request("DELETE", "/keys/1"), "DELETE", "/keys/1", None),
    ],
)
def test_paths_and_bodies(call: Callable[[ServiceClient], Any], method: str, path: str, body: Any) -> None:
    seen: list[httpx.Request] = []

    def handle(request: httpx.Request) -> httpx.Response:
        seen.append(request)
        return httpx.Response(200, json={"ok": True})

    with client(handle) as made:
        assert call(made) == {"ok": True}
    assert (seen[0].method, seen[0].url.path) == (method, "/api/v1" + path)
    assert (json.loads(seen[0].content) if seen[0].content else None) == body


def test_samples_and_timeline_repeat_lists_and_leave_out_what_is_not_asked() -> None:
    seen: list[str] = []

    def handle(request: httpx.Request) -> httpx.Response:
        seen.append(str(request.url.query, "ascii"))
        return httpx.Response(200, json={})

    with client(handle) as made:
        made.samples("x", ["roll_deg", "power_dbm"], 0, carriers=["c00", "c01"], count=7)
        made.samples("x", ["power_dbm"], 0, source="sa-2")
        made.timeline("x", stop="2026-11-21T03:00:00Z", methods=["robust"])
    start = "start=1970-01-01T00%3A00%3A00.000000Z"
    assert seen == [
        f"{start}&quantity=roll_deg&quantity=power_dbm&count=7&carrier=c00&carrier=c01",
        f"{start}&quantity=power_dbm&count=500&source=sa-2",
        "stop=2026-11-21T03%3A00%3A00Z&method=robust",
    ]


def test_a_report_of_links_gives_what_the_operator_wants() -> None:
    seen: list[httpx.Request] = []

    def handle(request: httpx.Request) -> httpx.Response:
        seen.append(request)
        return httpx.Response(200, json={"links": [{"id": "sa-1", "enabled": False, "reset": 2}]})

    assert client(handle).report_links([{"id": "sa-1"}]) == [{"id": "sa-1", "enabled": False, "reset": 2}]
    assert (seen[0].method, seen[0].url.path) == ("POST", "/api/v1/links:report")
    assert json.loads(seen[0].content) == {"links": [{"id": "sa-1"}]}


def test_history_follows_the_cursor_and_keeps_the_question() -> None:
    seen: list[dict[str, str]] = []

    def handle(request: httpx.Request) -> httpx.Response:
        seen.append(dict(request.url.params))
        number = len(seen)
        return httpx.Response(200, json={"rows": [{"n": number}], "next": f"p{number}" if number < 3 else None})

    rows = list(client(handle).attitude_history("x", 0, "2026-11-21T00:00:00Z", method="robust", limit=1))
    assert [row["n"] for row in rows] == [1, 2, 3]
    assert [query.get("cursor") for query in seen] == [None, "p1", "p2"]
    assert all(query["start"] == "1970-01-01T00:00:00.000000Z" for query in seen)


def test_the_smoothed_series_is_read_to_its_end() -> None:
    paths: list[str] = []

    def handle(request: httpx.Request) -> httpx.Response:
        paths.append(request.url.path)
        return httpx.Response(200, json={"rows": [{"n": len(paths)}], "next": "p" if len(paths) < 2 else None})

    rows = list(client(handle).smoothed_attitude("x", 0, "2026-11-21T00:00:00Z", limit=1))
    assert [row["n"] for row in rows] == [1, 2]
    assert set(paths) == {"/api/v1/spacecraft/x/attitude/smoothed"}


def test_waiting_for_a_job_reports_its_progress() -> None:
    states = iter([("queued", None), ("running", 0.4), ("done", 1.0)])
    progress: list[float] = []

    def handle(_: httpx.Request) -> httpx.Response:
        state, part = next(states)
        return httpx.Response(200, json={"state": state, "progress": part, "error": None})

    assert client(handle).wait_job("j", poll_s=0.0, on_progress=progress.append)["state"] == "done"
    assert progress == [0.0, 0.4, 1.0]


@pytest.mark.parametrize(("state", "match"), [("failed", "too few turns"), ("running", "without progress for 0 s")])
def test_a_job_that_fails_or_lasts_too_long(state: str, match: str) -> None:
    answer = {"state": state, "progress": 0.1, "error": "too few turns"}
    with pytest.raises(JobFailedError, match=match):
        client(lambda _: httpx.Response(200, json=answer)).wait_job("j", timeout_s=0.0, poll_s=0.0)


def test_a_job_is_waited_for_as_long_as_it_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s, progress = count(0.0, 9.0), count(0.01, 0.01)
    monkeypatch.setattr("service.client.jobs.time", SimpleNamespace(monotonic=lambda: next(now_s)))

    def answer(_request: httpx.Request) -> httpx.Response:
        share = next(progress)
        state = "done" if share > 0.5 else "running"
        return httpx.Response(200, json={"job": "j", "state": state, "progress": share})

    assert client(answer).wait_job("j", timeout_s=20.0, poll_s=0.0)["state"] == "done"


def test_epochs_as_numbers_or_text() -> None:
    assert epoch_text(1) == "1970-01-01T00:00:00.000001Z"
    assert epoch_text("2026-11-21T00:00:00Z") == "2026-11-21T00:00:00Z"
