"""Kill -9 of front end and service at random instants: what was measured arrives once, with its true levels.

A row is measured when it is on the spool's disk. The judge is the simulator's truth log, which neither side sees: the
traces that left the analyzer whole are all that a front end can know. What may be missing of them is the one in hand at
each kill of the front end, for it was never read to its end; a kill of the service costs nothing.
"""

import json
import random
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import chaos_clients as chaos
import numpy as np
import pytest
from waiting import wait_until

from analyzer_sim.world.ground import ground
from analyzer_sim.world.scenario.scenario import scenario_named
from analyzer_sim.world.world import World
from service.records.epoch import format_epoch

pytestmark = [pytest.mark.system, pytest.mark.slow]

SEED = 20261122
WORLD_SEED = 7
#: rows between a start and the next kill, beside a random wait
ROWS_BETWEEN = 10
LONGEST_WAIT_S = 0.6
PATIENCE_S = 120.0


class Child:
    """A process whose words go to a file."""

    def __init__(self, arguments: list[str], log: Path, environment: dict[str, str]) -> None:
        self.log = log
        with log.open("wb") as words:
            self.process = subprocess.Popen(
                [sys.executable, "-m", *arguments],
                stdin=subprocess.DEVNULL,
                stdout=words,
                stderr=words,
                env=environment,
            )

    def kill(self) -> None:
        """Kill it, if it still runs."""
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()

    def announced(self) -> dict[str, Any]:
        """Return its first line."""
        wait_until(lambda: b"\n" in self.log.read_bytes(), f"an announcement in {self.log}")
        return dict(json.loads(self.log.read_text().splitlines()[0]))


class Truth:
    """The log of the simulator, read as it grows."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._read = 0
        #: epoch of each completed sweep -> true level of each carrier
        self.sweeps: dict[str, dict[str, float | None]] = {}
        #: epochs of the traces that left whole, in order
        self.traces: list[str] = []
        #: session -> epoch of its newest trace; sessions in order
        self.newest: dict[str, str] = {}

    def grow(self) -> int:
        """Read what is new and return how many traces have left."""
        with self._path.open("rb") as log:
            log.seek(self._read)
            for line in log:
                if not line.endswith(b"\n"):
                    break
                self._read += len(line)
                self._consume(json.loads(line))
        return len(self.traces)

    def _consume(self, line: dict[str, Any]) -> None:
        if line["kind"] == "sweep":
            assert line["epoch"] not in self.sweeps, "the world showed a row twice"
            self.sweeps[line["epoch"]] = line["power_dbm"]
        elif line["kind"] == "trace":
            self.traces.append(line["epoch"])
            self.newest[line["session"]] = line["epoch"]


def micro(epoch: str) -> str:
    """Return an epoch of the simulator as the service tells it."""
    whole, _, fraction = epoch.removesuffix("Z").partition(".")
    return f"{whole}.{fraction:0<6}Z"


def spooled(folder: Path, copy: Path) -> tuple[set[str], int]:
    """Return the epochs that wait on the disk and the greatest number given, from a copy of the files."""
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(folder, copy)
    (path,) = copy.glob("*.spool")
    connection = sqlite3.connect(path)
    try:
        assert connection.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        waiting = {format_epoch(epoch_us) for (epoch_us,) in connection.execute("SELECT epoch_us FROM measured")}
        found = connection.execute("SELECT seq FROM sqlite_sequence WHERE name = 'measured'").fetchone()
        dropped = connection.execute("SELECT sum(count) FROM tally WHERE name LIKE 'dropped_%'").fetchone()[0]
    finally:
        connection.close()
    assert not dropped
    return waiting, int(found[0]) if found else 0


class Rig:
    """Simulator, service and front end of one test."""

    def __init__(self, folder: Path, start_service: Any, environment: dict[str, str]) -> None:
        self.folder, self._start_service = folder, start_service
        self._environment = environment
        self._children: list[Child] = []

    def open(self) -> None:
        """Start all three and tell the service what will be measured."""
        folder = self.folder
        log = folder / "truth.jsonl"
        arguments = ["analyzer_sim", "serve", "--scenario", "nominal", "--seed", str(WORLD_SEED), "--ideal"]
        arguments += ["--port", "0", "--ground-port", "0", "--operation-days", "60", "--truth-log", str(log)]
        analyzer = self._child(arguments, "analyzer.log", self._environment)
        self.service = self._start_service()
        world = World(scenario_named("nominal"), WORLD_SEED)
        carriers = world.plan_versions[0].carriers
        self.task_path = folder / "task.json"
        task = ground.task(world, carriers)
        task["sweeps"][0]["time_s"] = 0.1
        self.task_path.write_text(json.dumps(task))
        with self.service.client() as client:
            body = ground.spacecraft_body(world) | {"id": "sc"}
            assert client.post("/api/v1/spacecraft", json=body).status_code == 201
            plan = {"carriers": [ground.carrier_body(world, each) for each in carriers]}
            client.put("/api/v1/spacecraft/sc/carriers", json=plan).raise_for_status()
        self.key_file = folder / "station.key"
        self.key_id, key = self.make_key("0")
        self.key_file.write_text(key)
        self.url = self.service.url
        port = analyzer.announced()["scpi_port"]
        self.resource = f"TCPIP::127.0.0.1::{port}::SOCKET"
        self.truth = Truth(log)
        self.spool = folder / "spool"
        self.starts = 0
        self.front_end = self.start_front_end()

    def start_front_end(self) -> Child:
        """Start the front end on its spool."""
        self.starts += 1
        arguments = ["service", "acquire", "--task", str(self.task_path), "--spacecraft", "sc", "--json-log"]
        arguments += ["--resource", self.resource, "--service", self.url, "--epoch", "analyzer", "--period", "0"]
        arguments += ["--spool", str(self.spool)]
        named = {"SOO_KEY_FILE": str(self.key_file)}
        return self._child(arguments, f"acquire-{self.starts}.log", self._environment | named)

    def make_key(self, name: str) -> tuple[str, str]:
        """Return id and key of another key of the station."""
        with self.service.client() as client:
            body = {"name": f"front end {name}", "role": "station", "station": "front end"}
            made = client.post("/api/v1/keys", json=body).raise_for_status().json()
        return made["id"], made["key"]

    def _child(self, arguments: list[str], log: str, environment: dict[str, str]) -> Child:
        """Start a process that `close` ends."""
        child = Child(arguments, self.folder / log, environment)
        self._children.append(child)
        return child

    def restart_service(self) -> None:
        """Start the service again where it was."""
        self.service = self._start_service("--port", self.url.rpartition(":")[2], "--clock", "data")

    def await_load(self) -> None:
        """Wait until rows flow again."""
        wanted = self.truth.grow() + ROWS_BETWEEN

        def flows() -> bool:
            assert self.front_end.process.poll() is None, self.front_end.log.read_text()
            return self.truth.grow() >= wanted

        wait_until(flows, "rows to flow")

    def await_delivery(self) -> None:
        """Wait until the service stores rows again."""
        with self.service.client() as client:
            before = self._stored(client)
            wait_until(lambda: self._stored(client) > before, "rows to be stored")

    @staticmethod
    def _stored(client: Any) -> int:
        """Return how many rows the archive has."""
        answer = client.get("/api/v1/spacecraft/sc/sources").raise_for_status().json()
        return sum(source["rows"] for source in answer["rows"])

    def close(self) -> None:
        """End what the test started itself."""
        for child in self._children:
            child.kill()


@pytest.fixture
def rig(tmp_path: Path, start_service: Any, compiled_environment: dict[str, str]) -> Iterator[Rig]:
    """Give a running rig."""
    made = Rig(tmp_path, start_service, compiled_environment | {"OPENBLAS_NUM_THREADS": "1"})
    try:
        made.open()
        yield made
    finally:
        made.close()


def play(rig: Rig, kills: int) -> tuple[Counter[str], set[str], set[str]]:
    """Kill one or the other at random instants.

    Returns how often each died, all that was ever on the disk, and the sessions of the front ends that were killed:
    the last trace of each is what it had in hand.
    """
    draw = random.Random(SEED)
    victims = ["front end", "service"] * (kills // 2)
    draw.shuffle(victims)
    promised: set[str] = set()
    cut_off: set[str] = set()
    last_seq = 0
    for victim in victims:
        rig.await_load()
        if victim == "service" and draw.random() < 0.8:
            rig.await_delivery()  # the others die while they start
        time.sleep(draw.uniform(0.0, LONGEST_WAIT_S))
        if victim == "front end":
            rig.front_end.process.kill()
            rig.front_end.process.wait()
            waiting, seq = spooled(rig.spool, rig.folder / "copy")
            assert seq >= last_seq, "numbers went back"
            promised, last_seq = promised | waiting, seq
            rig.truth.grow()
            cut_off.add(next(reversed(rig.truth.newest)))
            rig.front_end = rig.start_front_end()
        else:
            rig.service.process.kill()
            rig.service.process.wait()
            rig.restart_service()
    return Counter(victims), promised, cut_off


def finish(rig: Rig) -> int:
    """Let the rest arrive and end the front end; return the greatest number given."""
    rig.service.await_announcement()
    rig.await_load()
    for _ in range(3):
        rig.front_end.process.send_signal(signal.SIGTERM)
        assert rig.front_end.process.wait(PATIENCE_S) == 0, rig.front_end.log.read_text()
        waiting, last_seq = spooled(rig.spool, rig.folder / "copy")
        if not waiting:
            rig.truth.grow()
            return last_seq
        rig.front_end = rig.start_front_end()
        rig.await_load()
    raise AssertionError(f"{len(waiting)} rows still wait in the spool")


def judge_levels(rows: list[dict[str, Any]], truth: Truth) -> None:
    """Compare levels with the truth, in units of the stated sigma."""
    sweeps = {micro(epoch): levels for epoch, levels in truth.sweeps.items()}
    off, misplaced = [], 0
    for row in rows:
        for carrier, level in sweeps[row["epoch"]].items():
            reported, sigma = row["power_dbm"][carrier], (row["measured_sigma_db"] or {}).get(carrier)
            if level is None or reported is None or sigma is None:
                misplaced += (level is None) != (reported is None)
            else:
                off.append((reported - level) / sigma)
    normalised = np.array(off)
    # sampling of a sweep costs up to .03 dB (analyzer tests), and a tenth of a million draws reach five sigma
    assert np.abs(normalised).max() < 7.0
    assert 0.5 < normalised.std() < 1.5
    assert misplaced == 0
    print(f"{normalised.size} levels: {normalised.mean():+.2f} +- {normalised.std():.2f} sigma off the truth")


def lose_and_double_nothing(rig: Rig, kills: int) -> None:
    """Kill, let the rest arrive, and compare the archive with the truth."""
    print(f"seed {SEED}, world {WORLD_SEED}")
    judge(rig, kills, *play(rig, kills))


def judge(rig: Rig, kills: int, died: Counter[str], promised: set[str], cut_off: set[str]) -> list[dict[str, Any]]:
    """Let the rest arrive, compare the archive with the truth, and return its rows."""
    last_seq = finish(rig)
    in_hand = {micro(rig.truth.newest[session]) for session in cut_off}
    with rig.service.client() as client:
        rows = chaos.history(client, "sc", start="2000-01-01T00:00:00Z", stop="2100-01-01T00:00:00Z")
        (source,) = client.get("/api/v1/spacecraft/sc/sources").raise_for_status().json()["rows"]
    epochs = [row["epoch"] for row in rows]
    read = [micro(epoch) for epoch in rig.truth.traces]
    missing = set(read) - set(epochs)
    unread = {micro(epoch) for epoch in rig.truth.sweeps} - set(read)
    print(f"{dict(died)}: {len(rig.truth.sweeps)} sweeps, {len(read)} traces read, {len(rows)} rows in the archive;")
    lost, doubled = (promised | set(read)) - in_hand - set(epochs), len(epochs) - len(set(epochs))
    print(f"lost {len(lost)}, doubled {doubled}, in hand {len(missing)}")
    assert doubled == 0
    assert set(epochs) <= set(read)
    assert promised <= set(epochs)
    # only what a killed front end had in hand, never a row for a kill of the service
    assert missing <= in_hand
    assert len(in_hand) <= died["front end"]
    # a sweep whose trace never left whole: at a kill, or when the next session began
    assert len(unread) <= 2 * rig.starts
    # every number that was given is in the archive, once
    assert sorted(row["seq"] for row in rows) == list(range(1, last_seq + 1))
    assert source["rows"] == last_seq
    assert len(rows) > 5 * kills
    judge_levels(rows, rig.truth)
    return rows


def test_keys_replaced_under_load_lose_and_double_nothing(rig: Rig) -> None:
    """The old key is revoked first; rows wait in the spool until the file has the new one."""
    brought = []
    for number in range(1, 4):
        rig.await_delivery()
        brought.append(rig.key_id)
        key_id, key = rig.make_key(str(number))
        with rig.service.client() as client:
            client.delete(f"/api/v1/keys/{rig.key_id}").raise_for_status()
        rig.await_load()
        assert spooled(rig.spool, rig.folder / "copy")[0], "no row waits for the new key"
        rig.key_file.write_text(key)
        rig.key_id = key_id
    rig.await_delivery()
    assert rig.starts == 1
    assert "key.invalid" in rig.front_end.log.read_text()
    rows = judge(rig, 0, Counter(), set(), set())
    assert list(dict.fromkeys(row["key_id"] for row in rows)) == [*brought, rig.key_id]


def test_a_kill_of_each_loses_and_doubles_nothing(rig: Rig) -> None:
    lose_and_double_nothing(rig, 2)


@pytest.mark.nightly
@pytest.mark.timeout(1200)
def test_fifty_kills_lose_and_double_nothing(rig: Rig) -> None:
    lose_and_double_nothing(rig, 50)
