"""Kill -9 twenty times under four posting clients: nothing acknowledged is lost, nothing is doubled.

The clients do what a front end does: a batch that got no answer is sent again unchanged. After every kill the files are
copied and read by themselves, before the service sees them again; at the end the interface must tell the same.
"""

import itertools
import random
import shutil
import sqlite3
import struct
import threading
import time
from collections import Counter
from pathlib import Path

import httpx
import pytest

pytestmark = [pytest.mark.system, pytest.mark.slow, pytest.mark.timeout(240)]

SEED = 20
KILLS = 20
CLIENTS = 4
ROWS = 5
CARRIERS = 16
BASE = "/api/v1/spacecraft"
#: 2026-11-21T00:00:00Z, and a row of any client every 100 ms from there
START_US = 1_795_219_200_000_000
STEP_US = 100_000
WINDOW = {"start": "2026-11-21T00:00:00Z", "stop": "2026-12-21T00:00:00Z"}


class FrontEnd(threading.Thread):
    """One client that sends batch after batch and repeats what was not answered."""

    def __init__(self, url: str, key: str, plan_id: int, number: int) -> None:
        super().__init__(name=f"front-end-{number}")
        self.source = f"sa-{number}"
        self._url, self._key, self._plan_id, self._number = url, key, plan_id, number
        self._random = random.Random(SEED + number)
        self._leave = threading.Event()
        self.lock = threading.Lock()
        #: epoch to powers of every row that was acknowledged
        self.acknowledged: dict[int, list[float]] = {}
        self.receipts: Counter[str] = Counter()
        self.repeated = 0
        self.faults: list[str] = []

    def stop(self) -> None:
        """Ask for the end after the batch in hand."""
        self._leave.set()

    def run(self) -> None:
        headers = {"Authorization": f"Bearer {self._key}"}
        with httpx.Client(base_url=self._url, headers=headers, timeout=5.0, trust_env=False) as client:
            for batch in itertools.count():
                if self._leave.is_set() or self.faults:
                    return
                self._send(client, batch)

    def _send(self, client: httpx.Client, batch: int) -> None:
        """Send one batch until it is acknowledged."""
        rows = {
            START_US + (CLIENTS * (ROWS * batch + row) + self._number) * STEP_US: [
                round(self._random.uniform(-60, -40), 3) for _ in range(CARRIERS)
            ]
            for row in range(ROWS)
        }
        body = {
            "plan_id": self._plan_id,
            "source": self.source,
            "first_seq": ROWS * batch,
            "measurements": [{"epoch": text_of(epoch_us), "power_dbm": powers} for epoch_us, powers in rows.items()],
        }
        while True:
            try:
                answer = client.post(f"{BASE}/sim-1/measurements:batch", json=body)
            except httpx.TransportError:
                answer = None
            if answer is not None and answer.status_code != 503:
                break
            self.repeated += 1
            time.sleep(0.05)
        self._take(answer, rows)

    def _take(self, answer: httpx.Response, rows: dict[int, list[float]]) -> None:
        """Book one receipt."""
        if answer.status_code != 200:
            self.faults.append(f"{answer.status_code} {answer.text}")
            return
        receipt = answer.json()
        figures = {name: receipt[name] for name in ("received", "accepted", "duplicates")}
        figures["refused"] = len(receipt["refused"])
        if figures["received"] != figures["accepted"] + figures["duplicates"] + figures["refused"]:
            self.faults.append(f"the receipt does not add up: {receipt}")
        with self.lock:
            self.receipts.update(figures)
            self.acknowledged.update(rows)


def text_of(epoch_us: int) -> str:
    """Return the epoch as the interface writes it."""
    seconds, micros = divmod(epoch_us, 1_000_000)
    return time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(seconds)) + f".{micros:06d}Z"


def stored_rows(database: Path, copy: Path) -> dict[tuple[str, int], bytes]:
    """Return what the files hold by source and epoch, after checking that the journal has no gap."""
    shutil.rmtree(copy, ignore_errors=True)
    copy.mkdir()
    # a kill before the first write of a start leaves no log
    for path in database.parent.glob("soo.db*"):
        if not path.name.endswith("-shm"):
            shutil.copy(path, copy)
    connection = sqlite3.connect(copy / "soo.db")
    try:
        assert connection.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        query = "SELECT source.name, epoch_us, powers FROM measurement JOIN source USING (spacecraft_key, source_key)"
        rows = [((name, epoch_us), powers) for name, epoch_us, powers in connection.execute(query)]
        numbers = [
            number
            for (number,) in connection.execute(
                "SELECT number FROM measurement UNION ALL SELECT number FROM journal ORDER BY number"
            )
        ]
        head = connection.execute("SELECT newest_number, consumed_number FROM head").fetchone()
        counts = dict(connection.execute("SELECT name, row_count FROM source").fetchall())
    finally:
        connection.close()
    # every number of the journal is taken exactly once, by a measurement or by a slow input
    assert numbers == list(range(1, len(numbers) + 1))
    assert head[0] == len(numbers)
    assert head[1] <= head[0]
    assert counts == dict(Counter(name for (name, _), _ in rows))
    assert len(dict(rows)) == len(rows)
    return dict(rows)


def all_acknowledged(front_ends: list[FrontEnd]) -> dict[tuple[str, int], list[float]]:
    """Return every row that a client was told is durable."""
    rows = {}
    for front_end in front_ends:
        with front_end.lock:
            rows |= {(front_end.source, epoch_us): powers for epoch_us, powers in front_end.acknowledged.items()}
    return rows


def history_epochs(client: httpx.Client) -> list[str]:
    """Return the epochs of the whole history, page after page."""
    epochs, params = [], {**WINDOW, "limit": 10_000}
    while True:
        page = client.get(f"{BASE}/sim-1/measurements/history", params=params).json()
        epochs += [row["epoch"] for row in page["rows"]]
        if page["next"] is None:
            return epochs
        params["cursor"] = page["next"]


def await_consumed(database: Path) -> None:
    """Wait until the chain has consumed the whole journal."""
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        connection = sqlite3.connect(f"file:{database}?mode=ro", uri=True)
        newest, consumed = connection.execute("SELECT newest_number, consumed_number FROM head").fetchone()
        connection.close()
        if newest == consumed:
            return
        time.sleep(0.1)
    raise AssertionError(f"the chain stands at {consumed} of {newest}")


def test_twenty_kills_lose_and_double_nothing(start_service, spacecraft, carriers, tmp_path):
    print(f"seed {SEED}")
    instants = random.Random(SEED)
    database = tmp_path / "soo.db"
    service = start_service()
    with service.client() as client:
        assert client.post(BASE, json=spacecraft).status_code == 201
        plan_id = client.put(f"{BASE}/sim-1/carriers", json={"carriers": carriers}).json()["plan_id"]
        key = client.headers["Authorization"].partition(" ")[2]
    url = service.url
    front_ends = [FrontEnd(url, key, plan_id, number) for number in range(CLIENTS)]
    for front_end in front_ends:
        front_end.start()
    port = url.rpartition(":")[2]
    try:
        for kill in range(KILLS):
            # anywhere between the first request after the start and well into the stream
            time.sleep(instants.uniform(0.0, 0.5))
            service.process.kill()
            service.process.wait()
            promised = all_acknowledged(front_ends)
            stored = stored_rows(database, tmp_path / "copy")
            assert promised.keys() <= stored.keys(), f"kill {kill}: {len(promised.keys() - stored.keys())} rows lost"
            service = start_service("--port", port, "--clock", "data")
            service.await_announcement()
    finally:
        for front_end in front_ends:
            front_end.stop()
        for front_end in front_ends:
            front_end.join(30)
    assert [front_end.faults for front_end in front_ends] == [[]] * CLIENTS
    assert sum(front_end.repeated for front_end in front_ends) >= KILLS
    promised = all_acknowledged(front_ends)
    assert len(promised) >= KILLS * CLIENTS * ROWS
    receipts = sum((front_end.receipts for front_end in front_ends), Counter())
    print(f"{dict(receipts)}, {sum(front_end.repeated for front_end in front_ends)} repetitions")
    assert receipts["refused"] == 0
    # every batch was acknowledged in the end: as new, or as known because only its answer was lost
    assert receipts["received"] == receipts["accepted"] + receipts["duplicates"] == len(promised)
    with service.client() as client:
        epochs = history_epochs(client)
        exported = client.get(f"{BASE}/sim-1/archive/measurements:export", params={"format": "csv", **WINDOW}).text
        await_consumed(database)
        prime = next(row for row in client.get(f"{BASE}/sim-1/sources").json()["rows"] if row["role"] == "prime")
        attitude = client.get(
            f"{BASE}/sim-1/archive/attitude:export", params={"format": "csv", "method": "paper", **WINDOW}
        ).text
    assert sorted(epochs) == sorted(text_of(epoch_us) for _, epoch_us in promised)
    assert len(exported.splitlines()) == 1 + len(promised)
    # of the rows of the prime source the chain made one row each, across twenty rebuilt chains
    assert len(attitude.splitlines()) == 1 + sum(1 for source, _ in promised if source == prime["id"])
    assert service.end()[0] == 0
    stored = stored_rows(database, tmp_path / "copy")
    assert stored == {row: struct.pack(f"<{CARRIERS}f", *powers) for row, powers in promised.items()}
