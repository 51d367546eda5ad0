"""``soo serve`` as operators meet it: a start, a stop, a second start, and the starts that cannot be."""

import socket
import time

import httpx
import pytest

pytestmark = pytest.mark.system

KEY = "a-key-for-tests-only"
BASE = "/api/v1/spacecraft"


def rows(first_s: int, count: int) -> list[dict]:
    """Return rows a second apart, that differ from one another."""
    return [
        {
            "epoch": f"2026-11-21T03:{second // 60:02d}:{second % 60:02d}.000000Z",
            "power_dbm": [-40.0 - second / 64] * 16,
        }
        for second in range(first_s, first_s + count)
    ]


def add_plan(client: httpx.Client, spacecraft: dict, carriers: list[dict]) -> int:
    """Store spacecraft and plan and return the plan's number."""
    assert client.post(BASE, json=spacecraft).status_code == 201
    put = client.put(f"{BASE}/sim-1/carriers", json={"carriers": carriers})
    assert put.status_code == 200, put.text
    return int(put.json()["plan_id"])


def test_it_announces_its_address_once_is_ready_never_writes_the_given_key_and_ends_by_sigint(start_service):
    service = start_service()
    announced = service.await_announcement()
    assert announced["url"].startswith("http://127.0.0.1:")
    assert announced["api"] == announced["url"] + "/api/v1"
    with service.client() as client:
        assert client.get("/readyz").status_code == 200
        assert client.get(BASE).status_code == 200
        assert client.get(BASE, headers={"Authorization": "Bearer another-key-than-ours"}).status_code == 401
        client.get("/api/v1/nothing-here")
    assert len(service.output.read_text().splitlines()) == 1
    assert service.end(2)[0] == 0
    written = service.written()
    assert [text for text in (KEY, "another-key-than-ours", "Traceback") if text in written] == []


def test_sigterm_ends_it_at_once_beside_open_streams_and_idle_connections(start_service, spacecraft, carriers):
    service = start_service()
    with service.client() as client, service.client() as streaming:
        add_plan(client, spacecraft, carriers)
        with streaming.stream("GET", f"{BASE}/sim-1/stream") as stream:
            assert stream.status_code == 200
            lines = stream.iter_lines()
            assert next(line for line in lines if line.startswith("event:")) == "event: status"
            # the other connection was used and is kept alive
            code, _ = service.end()
    assert code == 0, service.written()
    assert "Traceback" not in service.written()


def test_a_signal_during_the_start_ends_it_without_a_trace(start_service, tmp_path):
    service = start_service(database=tmp_path / "soo.db")
    # the interpreter has installed the handlers, the database is perhaps being made
    deadline = time.monotonic() + 120
    while not (service.output.parent / "soo.db").exists() and time.monotonic() < deadline:
        time.sleep(0.005)
    code, _ = service.end()
    assert code == 0, service.written()
    assert "Traceback" not in service.written()


def test_a_second_start_on_the_same_database_knows_everything(start_service, spacecraft, carriers, tmp_path):
    # the first one makes the database
    service = start_service(database=tmp_path / "soo.db")
    with service.client() as client:
        plan_id = add_plan(client, spacecraft, carriers)
        body = {"plan_id": plan_id, "source": "sa-1", "first_seq": 1, "measurements": rows(0, 90)}
        sent = client.post(f"{BASE}/sim-1/measurements:batch", json=body).json()
        assert (sent["received"], sent["accepted"], sent["durable"]) == (90, 90, True)
        window = {"start": "2026-11-21T00:00:00Z", "stop": "2026-11-22T00:00:00Z", "limit": 1000}
        before = client.get(f"{BASE}/sim-1/measurements/history", params=window).json()
        known = client.get(f"{BASE}/sim-1").json()
    assert service.end()[0] == 0
    again = start_service()
    with again.client() as client:
        assert client.get(f"{BASE}/sim-1").json() == known
        assert client.get(f"{BASE}/sim-1/carriers").json()["plan_id"] == plan_id
        assert client.get(f"{BASE}/sim-1/measurements/history", params=window).json() == before
        assert len(before["rows"]) == 90
        repeated = client.post(f"{BASE}/sim-1/measurements:batch", json=body).json()
        assert (repeated["accepted"], repeated["duplicates"]) == (0, 90)
    assert again.end()[0] == 0


def test_a_port_in_use_is_said_and_ends_with_code_two(start_service, tmp_path):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        service = start_service("--port", str(port), database=tmp_path / "other.db")
        assert service.process.wait(120) == 2
    assert f"cannot listen on 127.0.0.1:{port}" in service.written()
    assert "Traceback" not in service.written()
    assert service.output.read_text() == ""


CANNOT_BE = {
    ("--clock", "moon"): "clock",
    ("--port", "123456"): "port",
    ("--database", "sqlite://"): "in-memory",
    ("--database", "soo.db"): "URL cannot be read",
    ("--database", "oracle://x/y"): "oracle",
    ("--database", "sqlite:////nowhere/at/all/soo.db"): "unable to open database",
    ("--host", "no.such.host.invalid"): "cannot listen",
    ("--no-http",): "--no-http is for estimators beside services on a PostgreSQL server",
    ("--no-http", "--no-estimator", "--database", "postgresql+psycopg://x@/y"): "has nothing to do",
}


def test_what_cannot_be_served_is_said_and_ends_with_code_two(refused_starts, tmp_path):
    # what a test does not name could be served
    others = ["--port", "0", "--database", f"sqlite:///{tmp_path / 'soo.db'}"]
    ended = refused_starts(*(([*others, *arguments], {}) for arguments in CANNOT_BE))
    for (code, output), (arguments, said) in zip(ended, CANNOT_BE.items(), strict=True):
        assert (code, said in output) == (2, True), (arguments, code, output)
