"""Replicas and estimators on one PostgreSQL server, stopped, killed and started again: nothing is lost or doubled."""

import os
import random
import re
import signal
import socket
import subprocess
import sys
import time
from itertools import cycle
from pathlib import Path

import httpx
import numpy as np
import pytest
import yaml
from release_ground import OPERATION_US, PAYLOAD, SIGMA_DEG, record, seed_archive, until
from service_process import free_ports

from db.maintenance.doctor import diagnose
from service.records.epoch import format_epoch
from service.runtime.clock import system_now_us

pytestmark = [pytest.mark.system, pytest.mark.slow, pytest.mark.nightly]

ROOT = Path(__file__).resolve().parents[3]
SEED = 15
KEY = "a-key-for-tests-only"
PLAIN = {"SOO_BOOTSTRAP_KEY": KEY, "SOO_ACCESS_LOG": "false", "SOO_CLOCK": "data"}
NAMES = tuple(f"fleet-{number}" for number in range(4))
EVER = {"start": "2020-01-01T00:00:00Z", "stop": "2040-01-01T00:00:00Z"}
MINUTE_US = 60_000_000
#: a process is stopped for longer than a lease
STOPPED_S = 18.0


@pytest.fixture
def url(request):
    """URL of an archive on a server with calibrated spacecraft."""
    cluster = request.getfixturevalue("durable_postgresql_cluster")
    made = cluster.new_database()
    seed_archive(made, *(record(name) for name in NAMES))
    yield made
    cluster.drop(made)


class Fleet:
    """Two replicas on ports of their own, and two estimators without an interface."""

    def __init__(self, start_service, url):
        self._roles = [("--no-estimator", "--port", "0")] * 2 + [("--no-http",)] * 2
        self._start = lambda role: start_service(*role, "--database", url, environment=PLAIN)
        self.processes = [self._start(role) for role in self._roles]
        for each in self.processes:
            each.await_announcement()
        self.clients = [each.client() for each in self.processes[:2]]
        # one that starts again is asked where it was
        self._roles[:2] = [("--no-estimator", "--port", str(each.base_url.port)) for each in self.clients]

    def restart(self, position):
        self.processes[position] = self._start(self._roles[position])

    def ask(self, method, path, **options):
        """Return the first answer of a replica that is none of a process in trouble."""
        deadline_s, refused = time.monotonic() + 240.0, ""
        for client in cycle(self.clients):
            try:
                answer = client.request(method, path, **options)
            except httpx.TransportError as fault:
                refused = repr(fault)
            else:
                if answer.status_code != 503:
                    assert answer.is_success, answer.text
                    return answer
                refused = answer.text
            assert time.monotonic() < deadline_s, refused
            time.sleep(0.1)
        raise AssertionError

    def led(self, position):
        """Return the spacecraft that a process leads, as a replica reports it."""
        process = f"{socket.gethostname()}:{self.processes[position].process.pid}"
        rows = self.ask("GET", "/readyz").json()["leaders"]
        return {row["spacecraft"] for row in rows if row["process"] == process}


class Sender:
    """Front ends of all spacecraft: a row of each at a time, sent until it is acknowledged."""

    def __init__(self, ask):
        self._ask, self.count = ask, 0

    def rows(self, count):
        epochs_us = OPERATION_US + MINUTE_US * (self.count + 1 + np.arange(count))
        power_dbm = PAYLOAD.power_dbm(epochs_us, (0.0, 0.0, 0.0))
        rows = [
            {"epoch": format_epoch(int(each)), "power_dbm": row}
            for each, row in zip(epochs_us, power_dbm.tolist(), strict=True)
        ]
        for name in NAMES:
            body = {"plan_id": 1, "source": "sa-1", "measurements": rows}
            receipt = self._ask("POST", f"/api/v1/spacecraft/{name}/measurements:batch", json=body).json()
            assert receipt["accepted"] + receipt["duplicates"] == count, receipt
        self.count += count

    def align(self):
        self.rows(20)
        angles = {"yaw_deg": 0.0, "roll_deg": 0.0, "pitch_deg": 0.0, "sigma_deg": SIGMA_DEG, "source": "manual"}
        epoch = format_epoch(OPERATION_US + MINUTE_US * self.count)
        for name in NAMES:
            self._ask("POST", f"/api/v1/spacecraft/{name}/alignments", json={"epoch": epoch, **angles})

    def settle(self):
        for name in NAMES:
            until(
                lambda name=name: self._ask("GET", f"/api/v1/spacecraft/{name}/status").json()["pending"] == 0,
                f"rows of {name} are computed",
                300.0,
            )

    def results(self):
        """Return every attitude row of every spacecraft and method, as text."""
        found = {}
        for name in NAMES:
            for method in ("paper", "robust"):
                params = {
                    "format": "csv",
                    "method": method,
                    "start": "2020-01-01T00:00:00Z",
                    "stop": "2040-01-01T00:00:00Z",
                }
                text = self._ask("GET", f"/api/v1/spacecraft/{name}/archive/attitude:export", params=params).text
                found[name, method] = [line for line in text.splitlines() if not line.startswith("#")]
        return found


def results_of_one(start_service, folder, count):
    """Return what a single service on a file makes of the same rows."""
    database = folder / "alone.db"
    seed_archive(f"sqlite:///{database}", *(record(name) for name in NAMES))
    service = start_service("--port", "0", database=database, environment=PLAIN)
    with service.client() as client:
        sender = Sender(client.request)
        sender.align()
        while sender.count < count:
            sender.rows(min(10, count - sender.count))
        sender.settle()
        return sender.results()


@pytest.mark.parametrize("seconds", [60.0, pytest.param(600.0, marks=[pytest.mark.nightly, pytest.mark.timeout(1500)])])
def test_processes_killed_and_stopped_in_turn_lose_and_double_nothing(start_service, url, tmp_path, seconds):
    print(f"seed {SEED}")
    chosen, fleet = random.Random(SEED), Fleet(start_service, url)
    sender = Sender(fleet.ask)
    sender.align()
    until(lambda: len(fleet.led(2)) == len(fleet.led(3)) == 2, "estimators share the spacecraft out")
    ends_s, stopped_s, killed = time.monotonic() + seconds, 0.0, 0
    # the first estimator is stopped: the other one leads everything, and what the first writes late is refused
    stopped = fleet.processes[2]
    stopped.process.send_signal(signal.SIGSTOP)
    stopped_s = time.monotonic()
    while time.monotonic() < ends_s or stopped is not None:
        sender.rows(chosen.randint(1, 10))
        time.sleep(chosen.uniform(0.0, 1.0))
        if stopped is not None:
            if time.monotonic() - stopped_s > STOPPED_S:
                until(lambda: fleet.led(3) == set(NAMES), "the other one leads all")
                stopped.process.send_signal(signal.SIGCONT)
                stopped = None
            continue
        position = chosen.randrange(4)
        fleet.processes[position].end(signal.SIGKILL)
        sender.rows(chosen.randint(1, 3)) if position > 1 else None
        fleet.restart(position)
        fleet.processes[position].await_announcement()
        killed += 1
    until(lambda: len(fleet.led(2)) == len(fleet.led(3)) == 2, "those that came back have their share")
    sender.settle()
    found = sender.results()
    for client in fleet.clients:
        client.close()
    assert found == results_of_one(start_service, tmp_path, sender.count)
    assert all(len(lines) == sender.count + 1 for lines in found.values())
    print(f"{sender.count} rows of {len(NAMES)} spacecraft, {killed} processes killed")
    assert [each for each in diagnose(url, system_now_us(), lambda _: None) if each.state == "fault"] == []
    assert [each.end()[0] for each in fleet.processes] == [0] * 4


def test_the_script_starts_the_fleet(url):
    port = free_ports(4)
    environment = {**os.environ, **PLAIN, "SOO_DATABASE_URL": url, "SOO": f"{Path(sys.executable).parent}/soo"}
    script = subprocess.Popen([ROOT / "deploy/fleet/start.sh", str(port)], env=environment, start_new_session=True)
    headers = {"Authorization": f"Bearer {KEY}"}
    urls = [f"http://127.0.0.1:{port + number}" for number in range(4)]
    clients = [httpx.Client(base_url=each, headers=headers, trust_env=False, timeout=120.0) for each in urls]
    try:
        leaders = []

        def are_two():
            try:
                answers = [each.get("/readyz").json()["leaders"] for each in clients]
            except (httpx.TransportError, KeyError):
                return False
            leaders[:] = answers[0]
            return all(each == leaders for each in answers) and len({row["process"] for row in leaders}) == 2

        until(are_two, "two processes lead", 300.0)
        # an order is executed by the process that leads the spacecraft, and by no other
        answers = [client.post(f"/api/v1/spacecraft/{NAMES[0]}/control:arm") for client in clients]
        refused = [each.json() for each in answers if each.status_code == 503]
        assert [each["code"] for each in refused] == ["lease.elsewhere"] * 3
        leader = next(row["process"] for row in leaders if row["spacecraft"] == NAMES[0])
        assert all(leader in each["detail"] for each in refused)
    finally:
        for client in clients:
            client.close()
        script.terminate()
        assert script.wait(120) == 0


def test_the_files_of_the_fleet_name_the_same_processes():
    folder = ROOT / "deploy/fleet"
    services = yaml.safe_load((folder / "docker-compose.yml").read_text())["services"]
    ours = {name: each for name, each in services.items() if each["image"].startswith("soo:")}
    assert sorted(ours) == ["estimator-1", "estimator-2", "replica-1", "replica-2"]
    for name, each in ours.items():
        assert each["command"][:2] == ["soo", "serve"]
        assert ("--no-estimator" in each["command"]) == name.startswith("replica")
        assert set(each["secrets"]) == {"soo_bootstrap_key", "soo_database_url"}
    script = (folder / "start.sh").read_text()
    assert [script.count(f" {role}") for role in ("--no-estimator", "--estimator")] == [2, 2]
    addresses = {f"{name}:8000" for name in ours}
    (scraped,) = yaml.safe_load((folder / "prometheus.yml").read_text())["scrape_configs"]
    assert set(scraped["static_configs"][0]["targets"]) == addresses
    assert set(re.findall(r"server ([\w-]+:\d+)", (folder / "nginx.conf").read_text())) == addresses
    mounted = [volume.split(":")[0] for each in services.values() for volume in each.get("volumes", ())]
    assert all((folder / each).is_file() for each in mounted if each.startswith("."))
