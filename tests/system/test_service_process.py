"""The service as a process: how it starts, serves, raises alarms, and what its start costs."""

import json
import os
import re
import socket
import statistics
import subprocess
import sys
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from signal import SIGKILL

import httpx
import numpy as np
import pytest
from kept_results import kept

from analyzer_sim.export import export_arrays
from analyzer_sim.world.scenario.scenario import scenario_named
from analyzer_sim.world.world import World
from service.records.epoch import format_epoch, parse_epoch

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


#: each costs a tenth of a second and more, or ten megabytes and more
COSTLY = ("pyarrow", "matplotlib", "scipy", "numba", "prometheus_client", "httpx", "skyfield", "pyvisa")
MAX_RSS_MB = 225.0
#: modules that no command needs before it begins its work
WORKING = (*COSTLY, "numpy", "pydantic_settings", "fastapi", "sqlalchemy", "rich", "ssl", "sqlite3", "asyncio")
#: processor time of a start over that of ``import typer``; typer itself, which reads options by pydantic, takes 2.4
MAX_START_RATIO = 3.0
STARTS = (
    "service --help",
    "service serve --help",
    "service demo --help",
    "service acquire --help",
    "service keys list --service none",
    "service audit verify --help",
    "service study closed-loop --help",
    "analyzer_sim --help",
)
_RUNS = 7
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")


def test_costly_modules_are_not_loaded_by_a_service_without_work():
    code = (
        "import sys; import service.__main__, service.composition.bootstrap, service.cli.administration.serve;"
        "import service.api.server_process;"
        f"print(*[name for name in {COSTLY!r} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout.split() == []


def test_no_command_loads_what_it_works_with_before_it_begins():
    code = (
        "import sys, typer, service.__main__, analyzer_sim.__main__\n"
        "from service.cli.app import app\n"
        "def walk(group):\n"
        "    for command in group.commands.values():\n"
        "        walk(command) if hasattr(command, 'commands') else print(command.name)\n"
        "walk(typer.main.get_command(app))\n"
        f"print(*[name for name in {WORKING!r} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    *names, loaded = done.stdout.splitlines()
    assert len(names) > 20
    assert loaded == ""


def processor_s(*arguments):
    """Return the processor time of an interpreter with these arguments."""
    silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "stdin": subprocess.DEVNULL}
    # without a key an operator's command ends before it asks the service
    environment = {name: value for name, value in os.environ.items() if not name.startswith("SOO_")}
    process = subprocess.Popen([sys.executable, *arguments], env=environment, **silent)
    _, _, usage = os.wait4(process.pid, 0)
    process.returncode = 0
    return usage.ru_utime + usage.ru_stime


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "wait4"), reason="the system does not tell what a process took")
def test_a_command_starts_in_three_times_the_import_of_typer():
    taken = {words: [] for words in STARTS}
    reference = []
    for _ in range(_RUNS):
        reference.append(processor_s("-c", "import typer"))
        for words, times in taken.items():
            times.append(processor_s("-m", *words.split()))
    typer_s = statistics.median(reference)
    ratios = {words: statistics.median(times) / typer_s for words, times in taken.items()}
    for words, ratio in ratios.items():
        print(f"{ratio:.2f} {words}")
    assert max(ratios.values()) <= MAX_START_RATIO


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="the system does not tell what a process takes")
def test_start_and_idle_service_stay_small(start_service):
    # on a database that is there already
    service = start_service()
    with service.client() as client:
        assert client.get("/readyz").status_code == 200
        pid = service.process.pid
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        cpu_s = (int(fields[11]) + int(fields[12])) / _TICKS_PER_S
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
        rss_mb = int(next(line.split()[1] for line in lines if line.startswith("VmRSS"))) / 1024
    print(f"{cpu_s:.2f} s of processor time, {rss_mb:.0f} MB")
    assert rss_mb < MAX_RSS_MB


PAGE = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "use-the-python-client.md"


def test_examples_do_what_they_claim(start_service):
    examples = re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(), re.MULTILINE | re.DOTALL)
    assert len(examples) >= 5
    assert all("assert" in example for example in examples), "an example that claims nothing proves nothing"
    service = start_service()
    names = {"URL": service.url, "KEY": KEY}
    for example in examples:
        exec(compile(example, PAGE.name, "exec"), names)  # noqa: S102 - our own page
    assert service.end()[0] == 0
