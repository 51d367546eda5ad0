"""Clients: paths and bodies, repetition where it does no harm, events from chunks, rows as arrays."""

import importlib
import json
from collections.abc import Callable
from itertools import count
from types import SimpleNamespace
from typing import Any

import httpx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.client.backoff import Backoff
from service.client.call import SILENCE_S, Follower, StreamEvent
from service.client.problem import ProblemError, ServiceUnavailableError
from service.client.series_table import SeriesArrays, table_of_rows, table_of_samples
from service.client.service_client import JobFailedError, ServiceClient, epoch_text
from service.client.transport import Transport
from service.core.geometry.frames import body_from_nadir, quaternion_of_attitude


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
    monkeypatch.setattr("service.client.call.time", SimpleNamespace(monotonic=lambda: next(now_s)))

    def answer(_request: httpx.Request) -> httpx.Response:
        share = next(progress)
        state = "done" if share > 0.5 else "running"
        return httpx.Response(200, json={"job": "j", "state": state, "progress": share})

    assert client(answer).wait_job("j", timeout_s=20.0, poll_s=0.0)["state"] == "done"


def test_epochs_as_numbers_or_text() -> None:
    assert epoch_text(1) == "1970-01-01T00:00:00.000001Z"
    assert epoch_text("2026-11-21T00:00:00Z") == "2026-11-21T00:00:00Z"


PROBLEM = {
    "type": "about:blank",
    "title": "Not found",
    "status": 404,
    "detail": "there is no plan 9",
    "code": "plan.unknown",
    "request_id": "r-1",
    "errors": [{"pointer": "/plan_id", "code": "plan.unknown", "detail": "9"}],
}


def transport(*answers: httpx.Response | Exception, retries: int = 3) -> tuple[Transport, list[httpx.Request]]:
    """Return a transport that gets these answers, and the requests it makes."""
    requests: list[httpx.Request] = []
    script = iter(answers)

    def handle(request: httpx.Request) -> httpx.Response:
        requests.append(request)
        answer = next(script)
        if isinstance(answer, Exception):
            raise answer
        return answer

    made = Transport(
        "http://service/", "secret", http=httpx.MockTransport(handle), retries=retries, sleep=lambda _: None
    )
    return made, requests


def test_key_and_body_go_with_the_request() -> None:
    made, requests = transport(httpx.Response(200, json={"a": 1}))
    assert made.request("PUT", "/x", {"b": 2}, params={"c": 3, "d": None}) == {"a": 1}
    assert requests[0].headers["authorization"] == "Bearer secret"
    assert json.loads(requests[0].content) == {"b": 2}
    assert str(requests[0].url) == "http://service/api/v1/x?c=3"


@pytest.mark.parametrize("status", [401, 403])
def test_a_replaced_key_is_taken_where_the_former_is_refused(status: int) -> None:
    sent: list[str] = []

    def handle(request: httpx.Request) -> httpx.Response:
        sent.append(request.headers["authorization"].removeprefix("Bearer "))
        return httpx.Response(200 if sent[-1] == "new" else status, json={"code": "key.invalid"})

    stored: list[str | None] = [None, "old", "new"]
    made = Transport("http://service", "old", http=httpx.MockTransport(handle), stored_key=lambda: stored.pop(0))
    for _ in range(2):
        with pytest.raises(ProblemError):
            made.request("POST", "/x", {})
    assert sent == ["old", "old"]
    for _ in range(2):
        made.request("POST", "/x", {})
    assert sent[2:] == ["old", "new", "new"]


def test_health_stands_outside_the_base_path() -> None:
    made, requests = transport(httpx.Response(204))
    assert made.request("GET", "/healthz") is None
    assert requests[0].url.path == "/healthz"


def test_a_problem_is_an_error_with_all_its_parts() -> None:
    made, requests = transport(httpx.Response(404, json=PROBLEM))
    with pytest.raises(ProblemError, match="r-1") as caught:
        made.request("GET", "/x")
    error = caught.value
    assert (error.status, error.code, error.detail, error.request_id) == (404, "plan.unknown", PROBLEM["detail"], "r-1")
    assert error.errors[0]["pointer"] == "/plan_id"
    assert len(requests) == 1


def test_a_page_of_a_proxy_is_an_error_too() -> None:
    made, _ = transport(httpx.Response(404, text="<html>"))
    with pytest.raises(ProblemError) as caught:
        made.request("GET", "/x")
    assert caught.value.code == "http.404"


@pytest.mark.parametrize(
    ("method", "is_keyed", "attempts"), [("GET", False, 4), ("PUT", False, 4), ("POST", True, 4), ("POST", False, 1)]
)
@pytest.mark.parametrize("failure", [httpx.Response(503), httpx.ReadTimeout("slow"), httpx.RemoteProtocolError("cut")])
def test_only_what_may_be_repeated_is(
    method: str, is_keyed: bool, attempts: int, failure: httpx.Response | Exception
) -> None:
    made, requests = transport(*[failure] * 9)
    with pytest.raises(ServiceUnavailableError):
        made.request(method, "/x", is_keyed=is_keyed)
    assert len(requests) == attempts


def test_a_request_that_was_never_sent_is_repeated() -> None:
    made, requests = transport(httpx.ConnectError("refused"), httpx.Response(201, json={}))
    assert made.request("POST", "/x", {}) == {}
    assert len(requests) == 2


def test_the_services_own_waiting_time_is_kept() -> None:
    waits: list[float] = []
    answers = iter([httpx.Response(429, headers={"retry-after": "7"}), httpx.Response(200, json={})])
    made = Transport("http://s", None, http=httpx.MockTransport(lambda _: next(answers)), sleep=waits.append)
    made.request("GET", "/x")
    assert waits == [7.0]


def test_a_good_answer_that_is_no_json_is_unavailable() -> None:
    made, _ = transport(httpx.Response(200, text="<html>"), retries=0)
    with pytest.raises(ServiceUnavailableError, match="not JSON"):
        made.request("GET", "/x")


def test_nan_is_not_sent() -> None:
    made, requests = transport()
    with pytest.raises(ValueError, match="not JSON compliant"):
        made.request("PUT", "/x", {"a": float("nan")})
    assert requests == []


def test_no_key_no_header() -> None:
    seen: list[Any] = []

    def handle(request: httpx.Request) -> httpx.Response:
        seen.append(request.headers.get("authorization"))
        return httpx.Response(200, json={})

    with Transport("http://s", None, http=httpx.MockTransport(handle)) as made:
        made.request("GET", "/x")
    assert seen == [None]


def test_jitter_shortens_and_reset_starts_again() -> None:
    backoff = Backoff(first_s=1.0, limit_s=4.0, jitter=0.5, draw=lambda: 1.0)
    # powers of two times one half: exact in float64
    assert [backoff.next_s() for _ in range(4)] == [0.5, 1.0, 2.0, 2.0]
    backoff.reset()
    assert backoff.next_s() == 0.5


def test_a_download_is_given_piece_by_piece_and_asked_once() -> None:
    made, requests = transport(httpx.Response(200, content=iter([b"epoch,", b"source\r\n"])))
    with made:
        chunks = list(made.download("/archive", {"format": "csv", "version": None}))
    assert b"".join(chunks) == b"epoch,source\r\n"
    assert [str(request.url) for request in requests] == ["http://service/api/v1/archive?format=csv"]


def test_a_refused_download_is_its_problem_and_a_broken_one_says_so() -> None:
    made, _ = transport(httpx.Response(404, json=PROBLEM), httpx.ReadError("gone"))
    with made:
        with pytest.raises(ProblemError, match="no plan 9"):
            list(made.download("/archive"))
        with pytest.raises(ServiceUnavailableError, match="broke off"):
            list(made.download("/archive"))


BODY = (
    'retry: 2000\n\nid: a:1.0.0\nevent: status\ndata: {"name":"line\u2028separator \u0085"}\n\n: heartbeat\n\n'
    'id: a:2.0.0\r\nevent: measurement\r\ndata: {"n":\r\ndata: 2}\r\n\r\n'
).encode()
EVENTS = [
    StreamEvent("a:1.0.0", "status", {"name": "line\u2028separator \u0085"}),
    StreamEvent("a:2.0.0", "measurement", {"n": 2}),
]


@pytest.mark.parametrize("size", [1, 2, 3, 7, 50, 1000])
def test_chunks_may_be_cut_anywhere(size):
    follower = Follower()
    chunks = [BODY[position : position + size] for position in range(0, len(BODY), size)]
    assert [event for chunk in chunks for event in follower.consume(chunk)] == EVENTS
    assert follower.last_event_id == "a:2.0.0"


def test_what_was_cut_off_is_forgotten_with_its_connection():
    follower = Follower()
    assert list(follower.consume(b"id: a:1.0.0\nevent: status\ndata: {}\n\nid: a:9.9.9\nda")) != []
    assert follower.headers()["Last-Event-ID"] == "a:1.0.0"
    assert [event.id for event in follower.consume(b"id: a:2.0.0\nevent: status\ndata: {}\n\n")] == ["a:2.0.0"]


def test_an_id_alone_says_how_far_the_stream_has_got():
    follower = Follower()
    assert list(follower.consume(b"id: a:1.0.0\n\n: heartbeat\n\nid: a:5.0.0\n\n")) == []
    assert follower.headers()["Last-Event-ID"] == "a:5.0.0"


def test_without_an_id_none_is_sent():
    assert "Last-Event-ID" not in Follower().headers()
    assert Follower("a:1.0.0").headers()["Last-Event-ID"] == "a:1.0.0"
    assert Follower().timeout(httpx.Timeout(3.0)).read == SILENCE_S


def test_waits_grow_until_an_event_comes_and_follow_the_service():
    follower = Follower()
    fault = ServiceUnavailableError("gone")
    waits = [follower.wait_after(fault) for _ in range(12)]
    assert waits[0] <= 0.2
    assert waits[-1] <= 15.0
    assert waits[-1] > 5.0
    assert follower.wait_after(ServiceUnavailableError("busy", 503, 7.0)) == 7.0
    assert follower.wait_after(ServiceUnavailableError("busy", 503, 1e9)) == 60.0
    list(follower.consume(b"id: a:1.0.0\nevent: status\ndata: {}\n\n"))
    assert follower.wait_after(fault) <= 0.2


def test_patience_ends():
    now = [0.0]
    follower = Follower(patience_s=30.0, clock=lambda: now[0])
    fault = ServiceUnavailableError("gone")
    follower.wait_after(fault)
    now[0] = 29.0
    follower.wait_after(fault)
    list(follower.consume(b"id: a:1.0.0\nevent: status\ndata: {}\n\n"))
    now[0] = 100.0
    follower.wait_after(fault)
    now[0] = 131.0
    with pytest.raises(ServiceUnavailableError, match="gone"):
        follower.wait_after(fault)


EPOCHS = ["2026-11-21T03:00:00.000000Z", "2026-11-21T03:01:00.500000Z"]
AXES = ("yaw_deg", "roll_deg", "pitch_deg")


def row(epoch: str, yaw_deg: float | None = 0.3, **others: Any) -> dict[str, Any]:
    """Return an attitude row as the contract has it."""
    angles = {"yaw_deg": yaw_deg, "roll_deg": -0.2, "pitch_deg": 0.1}
    sigma = {"sigma_deg": {"yaw": 0.1, "roll": 0.01, "pitch": None}, "rates_deg_s": None}
    words = {"method": "robust", "version": "live", "status": "ACQUIRED", "received_at": epoch}
    return {"epoch": epoch, **angles, **sigma, **words, "carriers_used": 12, "downlink_fade": False, **others}


def test_numbers_become_columns_with_units_and_shared_words_attributes() -> None:
    table = table_of_rows([row(EPOCHS[0]), row(EPOCHS[1], None, status="INVALID")])
    assert table.epochs.tolist()[1].isoformat() == "2026-11-21T03:01:00.500000"
    np.testing.assert_array_equal(table.columns["yaw_deg"], [0.3, np.nan])
    np.testing.assert_array_equal(table.columns["roll_sigma_deg"], [0.01, 0.01])
    assert table.columns.keys() == {*AXES, "yaw_sigma_deg", "roll_sigma_deg", "carriers_used"}
    assert table.units == dict.fromkeys([*AXES, "yaw_sigma_deg", "roll_sigma_deg"], "deg")
    assert table.attributes == {"method": "robust", "version": "live"}


def test_rows_without_a_value_can_be_left_out() -> None:
    table = table_of_rows([row(EPOCHS[0], None), row(EPOCHS[1])]).complete(*AXES)
    assert table.columns["yaw_deg"].tolist() == [0.3]
    assert len(table.epochs_us) == len(table.columns["carriers_used"]) == 1
    assert len(table.rotations()) == 1


def test_no_rows_give_no_columns() -> None:
    table = table_of_rows([])
    assert (len(table.epochs), table.columns, table.units) == (0, {}, {})


def test_samples_are_named_by_method_or_carrier() -> None:
    series = [
        {"quantity": "roll_deg", "method": "paper", "carrier": None, "avg": [1.0, None], "min": [0.5, None]},
        {"quantity": "power_dbm", "method": None, "carrier": "c00", "avg": [-42.0, -43.0], "min": [-44.0, -45.0]},
    ]
    samples = {"series": series, "epochs": EPOCHS, "interval_s": 60, "version": "live"}
    table = table_of_samples(samples, "min")
    np.testing.assert_array_equal(table.columns["paper_roll_deg"], [0.5, np.nan])
    assert table.units == {"paper_roll_deg": "deg", "c00_power_dbm": "dBm"}
    assert table.attributes == {"statistic": "min", "version": "live", "interval_s": "60"}


@given(st.lists(st.tuples(*[st.floats(-89.0, 89.0)] * 3), min_size=1, max_size=5))
def test_rotations_are_those_of_the_frames(attitude_deg: list[tuple[float, float, float]]) -> None:
    angles = np.array(attitude_deg)
    columns = dict(zip(AXES, angles.T, strict=True))
    rotations = SeriesArrays(np.arange(len(angles)), columns).rotations()
    np.testing.assert_allclose(rotations.inv().as_matrix(), body_from_nadir(angles), atol=1e-14)
    # messages name the frame rotation nadir -> body, which is the turn of the body itself
    alignment = np.abs(np.sum(rotations.as_quat() * quaternion_of_attitude(angles), axis=-1))
    np.testing.assert_allclose(alignment, 1.0, atol=1e-14)


def test_a_row_without_an_attitude_is_no_rotation() -> None:
    table = table_of_rows([row(EPOCHS[0]), row(EPOCHS[1], None)])
    with pytest.raises(ValueError, match=r"1 rows have no attitude, the first at 2026-11-21T03:01:00\.500000Z; call"):
        table.rotations()


def test_pandas_and_xarray_keep_instants_units_and_attributes() -> None:
    table = table_of_rows([row(EPOCHS[0]), row(EPOCHS[1], None)])
    frame = table.to_pandas()
    assert [instant.isoformat() for instant in frame.index][1] == "2026-11-21T03:01:00.500000+00:00"
    assert (frame.attrs["units"]["yaw_deg"], frame.attrs["method"]) == ("deg", "robust")
    data = table.to_xarray()
    assert (data["yaw_deg"].attrs, data["carriers_used"].attrs) == ({"units": "deg"}, {})
    assert (data.attrs["version"], data["epoch"].attrs["time_system"]) == ("live", "UTC")
    np.testing.assert_array_equal(data["epoch"].values.astype("datetime64[us]"), table.epochs)
    np.testing.assert_array_equal(frame["yaw_deg"].to_numpy(), data["yaw_deg"].values)


def test_a_missing_package_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str, *others: Any) -> Any:
        raise ModuleNotFoundError(name=name)

    table = table_of_rows([row(EPOCHS[0])])
    monkeypatch.setattr(importlib, "import_module", missing)
    for convert in (table.to_pandas, table.to_xarray):
        with pytest.raises(ModuleNotFoundError, match=r"is not installed; pip install soo\[analysis\]"):
            convert()
