"""A simulated story through a real service: a carrier is switched off, alarms, is acknowledged, returns and closes."""

import json
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from signal import SIGKILL

import numpy as np
import pytest
from kept_results import kept

from analyzer_sim.export import export_arrays
from analyzer_sim.world.scenario.scenario import scenario_named
from analyzer_sim.world.world import World
from service.records.epoch import format_epoch, parse_epoch

pytestmark = pytest.mark.system

KEY = "a-key-for-tests-only"
SC = "/api/v1/spacecraft/sim-1"
#: rows of the story around the hours in which one carrier is off
BEFORE, AFTER = 60, 20


def silence(scenario, seed):
    """Return epochs, powers and carriers of a world, cut around the silence of its switched-off carrier."""
    world = export_arrays(World(scenario_named(scenario), seed))
    power_dbm, epochs_us = world["power_dbm"], world["epoch_us"]
    (carrier,) = np.flatnonzero(np.isnan(power_dbm).any(axis=0))
    off = np.flatnonzero(np.isnan(power_dbm[:, carrier]))
    cut = slice(int(off[0]) - BEFORE, int(off[-1]) + 1 + AFTER)
    return epochs_us[cut].tolist(), power_dbm[cut], int(carrier), len(off)


@pytest.fixture(scope="module")
def story():
    """The silence of the demonstration."""
    return kept(silence, "demo", 1)


class Hook:
    """A receiver of notices."""

    def __init__(self):
        self.notices = []
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self):
                body = self.rfile.read(int(self.headers["Content-Length"]))
                outer.notices.append(json.loads(body))
                self.send_response(204)
                self.end_headers()

            def log_message(self, *_):
                pass

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        threading.Thread(target=self.server.serve_forever, args=(0.05,), daemon=True).start()

    def reported(self):
        return [(notice["change"], notice["thing"]) for notice in self.notices]


@pytest.fixture
def hook():
    hook = Hook()
    yield hook
    hook.server.shutdown()
    hook.server.server_close()


def wait_for(question, timeout_s=120.0):
    """Return the first answer that is not empty."""
    deadline = time.monotonic() + timeout_s
    while not (answer := question()):
        assert time.monotonic() < deadline, "did not happen in time"
        time.sleep(0.05)
    return answer


class OrbitalFrameSpacecraft:
    """What front end and operator do over one client."""

    def __init__(self, client, story, plan_id):
        self.client, self.plan_id = client, plan_id
        self.epochs_us, self.power_dbm, _, _ = story

    def send(self, first, stop, absent=()):
        rows = []
        for k in range(first, stop):
            powers = [None if np.isnan(p) or n in absent else float(p) for n, p in enumerate(self.power_dbm[k])]
            rows.append({"epoch": format_epoch(self.epochs_us[k]), "power_dbm": powers})
        body = {"plan_id": self.plan_id, "source": "sa-1", "measurements": rows}
        answer = self.client.post(f"{SC}/measurements:batch", json=body)
        assert answer.status_code == 200, answer.text
        assert answer.json()["accepted"] == stop - first
        return answer.json()["late"]

    def consumed(self):
        """Return a row for each measurement that the chain has seen; rows before it are late from then on."""
        return self.client.get(f"{SC}/attitude/history", params={"limit": 10_000}).json()["rows"]

    def alarms(self, state="open"):
        return self.client.get(f"{SC}/alarms", params={"state": state}).json()["rows"]


def test_a_switched_off_carrier_alarms_is_acknowledged_and_closes_when_it_returns(
    start_service, spacecraft, carriers, story, hook, tmp_path
):
    epochs_us, _, carrier, silent = story
    name, off, back = carriers[carrier]["id"], BEFORE, BEFORE + silent
    hook_url = f"http://127.0.0.1:{hook.server.server_port}/"
    environment = {"SOO_BOOTSTRAP_KEY": KEY, "SOO_ALARM_WEBHOOK_URL": hook_url, "SOO_ALARMS__CHECK_PERIOD_S": "0.2"}
    service = start_service(environment=environment)
    with service.client() as client:
        assert client.post("/api/v1/spacecraft", json=spacecraft).status_code == 201
        put = client.put(f"{SC}/carriers", json={"carriers": carriers})
        record = OrbitalFrameSpacecraft(client, story, put.json()["plan_id"])
        record.send(30, off + 1)
        wait_for(lambda: len(record.consumed()) == off + 1 - 30)
        # one row of silence, and rows of the past in which every carrier is absent, alarm nothing
        assert record.send(0, 30, absent=range(16)) == 30
        assert record.alarms() == []
        record.send(off + 1, off + 30)
        (alarm,) = wait_for(record.alarms)
        assert (alarm["condition"], alarm["thing"], alarm["state"]) == ("carrier_absent", name, "unacknowledged")
        assert parse_epoch(alarm["since"]) == epochs_us[off]
        # within its debounce of 120 s, to a row
        assert 0 <= parse_epoch(alarm["raised_at"]) - epochs_us[off] - 120_000_000 < 60_000_000
        wait_for(lambda: hook.reported() == [("raised", name)])
        seen = client.post(f"/api/v1/alarms/{alarm['id']}:acknowledge", json={"comment": "its user was called"})
        assert seen.json()["state"] == "acknowledged"
        wait_for(lambda: len(hook.reported()) == 2)
    service.end(SIGKILL)
    service = start_service(environment=environment)
    with service.client() as client:
        record.client = client
        # a restart forgets nothing and repeats nothing
        (kept,) = record.alarms()
        assert (kept["id"], kept["state"], kept["acknowledged"]["comment"]) == (
            alarm["id"],
            "acknowledged",
            "its user was called",
        )
        # an hour of silence is worse than what was acknowledged
        record.send(off + 30, off + 100)
        wait_for(lambda: record.alarms("unacknowledged"))
        worse = client.post(f"/api/v1/alarms/{alarm['id']}:acknowledge").json()
        assert (worse["severity"], worse["state"]) == ("distress", "acknowledged")
        record.send(off + 100, back + AFTER)
        wait_for(lambda: not record.alarms())
        history = client.get(f"/api/v1/alarms/{alarm['id']}").json()
        changes = [(change["change"], change["at"]) for change in history["changes"] if change["change"] != "repeated"]
        assert [change for change, _ in changes] == ["raised", "acknowledged", "escalated", "acknowledged", "returned"]
        returned_us = parse_epoch(changes[-1][1])
        assert 0 <= returned_us - epochs_us[back] - 120_000_000 < 60_000_000
    wait_for(lambda: hook.reported()[-1] == ("returned", name))
    assert hook.reported()[:3] == [("raised", name), ("acknowledged", name), ("escalated", name)]
    assert {thing for _, thing in hook.reported()} == {name}
    assert service.end()[0] == 0
    assert "Traceback" not in service.written()
