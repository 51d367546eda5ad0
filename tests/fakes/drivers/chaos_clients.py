"""Posting clients for chaos tests, and the three ways of the interface to tell what is stored.

Clients do what front ends do: a batch that got no answer, or a 503, is sent again unchanged. What they send is what
front ends send on bad days: reordered, late, repeated, contradicting, future and non-finite rows; every receipt is
compared with what the rows deserve.
"""

import contextlib
import csv
import os
import random
import signal
import subprocess
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Any

import httpx

BASE = "/api/v1/spacecraft"
CARRIERS = 16
ROWS = 6
#: 2026-11-21T00:00:00Z, and a row of any client every 100 ms from there
START_US = 1_795_219_200_000_000
STEP_US = 100_000
WINDOW = {"start": "2026-11-20T00:00:00Z", "stop": "2026-12-21T00:00:00Z"}
#: further ahead than the data clock lets an epoch be
FUTURE_US = 60 * 86_400 * 1_000_000
#: how a batch can be spoilt
KINDS = ("plain", "reordered", "repeated", "conflicting", "future", "late", "not_finite")


class ChaosClient(threading.Thread):
    """One source that sends batch after batch until it is told to stop, and every batch until it is answered.

    Parameters
    ----------
    url, key : str
        The service.
    plan_id : int
        Carrier plan of the rows.
    number, clients : int
        Which of how many sources this is; their epochs interleave.
    seed : int
        Of its choices.
    """

    def __init__(self, url: str, key: str, plan_id: int, number: int, clients: int, seed: int) -> None:
        super().__init__(name=f"client-{number}", daemon=True)
        self.source = f"sa-{number}"
        self._url, self._key, self._plan_id = url, key, plan_id
        self._number, self._clients = number, clients
        self._random = random.Random(1000 * seed + number)
        self._leave = threading.Event()
        self.lock = threading.Lock()
        #: epoch to powers of every row that was acknowledged as stored
        self.acknowledged: dict[int, list[float]] = {}
        self.counts: Counter[str] = Counter()
        self.codes: Counter[str] = Counter()
        self.faults: list[str] = []
        #: longest wait for an answer
        self.slowest_s = 0.0
        #: where rows that come late belong: places left out before
        self._left_out: list[int] = []
        self._position = 0

    def stop(self) -> None:
        """Ask for the end after the batch in hand."""
        self._leave.set()

    def run(self) -> None:
        headers = {"Authorization": f"Bearer {self._key}"}
        with httpx.Client(base_url=self._url, headers=headers, timeout=120.0, trust_env=False) as client:
            while not self._leave.is_set() and not self.faults:
                kind = self._random.choice(KINDS) if self._position else "plain"
                rows, wanted = self._batch(kind)
                self._deliver(client, kind, rows, wanted)

    def _batch(self, kind: str) -> tuple[dict[int, list[float]], Counter[str]]:
        """Return rows in the order of sending, and what each of them deserves."""
        fresh = {self._next_us(): self._powers() for _ in range(ROWS)}
        wanted: Counter[str] = Counter(stored=ROWS)
        rows = dict(fresh)
        if kind == "reordered":
            rows = dict(self._random.sample(list(fresh.items()), ROWS))
        elif kind == "late" and self._left_out:
            rows[self._left_out.pop()] = self._powers()
            wanted["stored"] += 1
        elif kind in ("repeated", "conflicting"):
            with self.lock:
                epoch_us, powers = self._random.choice(list(self.acknowledged.items()))
            rows[epoch_us] = powers if kind == "repeated" else [power - 3.0 for power in powers]
            wanted["stored" if kind == "repeated" else "measurement.conflict"] += 1
        elif kind == "future":
            rows[START_US + FUTURE_US + self._position] = self._powers()
            wanted["time.future"] += 1
        return rows, wanted

    def _next_us(self) -> int:
        """Return the next epoch of this source; now and then one is left out, to be sent late."""
        if self._random.random() < 0.1:
            self._left_out.append(START_US + (self._clients * self._position + self._number) * STEP_US)
            self._position += 1
        self._position += 1
        return START_US + (self._clients * (self._position - 1) + self._number) * STEP_US

    def _powers(self) -> list[float]:
        return [round(self._random.uniform(-60, -40), 3) for _ in range(CARRIERS)]

    def _deliver(self, client: httpx.Client, kind: str, rows: dict[int, list[float]], wanted: Counter[str]) -> None:
        """Send one batch until it is answered, and book the answer."""
        body: dict[str, Any] = {
            "plan_id": self._plan_id,
            "source": self.source,
            "measurements": [{"epoch": text_of(epoch_us), "power_dbm": powers} for epoch_us, powers in rows.items()],
        }
        if kind == "not_finite":
            self._refused_whole(client, body)
        answer = self._answered(client, "json", body)
        if answer is None:
            return
        if answer.status_code != 200:
            self.faults.append(f"{answer.status_code} {answer.text}")
            return
        self._engine(kind, rows, wanted, answer.json())

    def _refused_whole(self, client: httpx.Client, body: dict[str, Any]) -> None:
        """Send the batch with NaN in its last row: none of it may be stored."""
        text = httpx.Request("POST", self._url, json=body).content.decode()
        spoilt = text[: text.rindex("[")] + "[NaN" + ",-50.0" * (CARRIERS - 1) + "]}]}"
        answer = self._answered(client, "content", spoilt.encode())
        if answer is not None and answer.status_code not in (400, 422):
            self.faults.append(f"NaN: {answer.status_code} {answer.text}")
        self.counts["refused whole"] += 1

    def _answered(self, client: httpx.Client, form: str, body: Any) -> httpx.Response | None:
        """Return the first answer that is none of a service in trouble; None when asked to stop meanwhile."""
        while True:
            asked_s = time.monotonic()
            try:
                answer = client.post(f"{BASE}/sim-1/measurements:batch", **{form: body})
            except httpx.TransportError as error:
                self.codes[type(error).__name__] += 1
            else:
                self.slowest_s = max(self.slowest_s, time.monotonic() - asked_s)
                if answer.status_code != 503:
                    return answer
                self.codes[answer.json()["code"]] += 1
                if "Retry-After" not in answer.headers:
                    self.faults.append(f"503 without Retry-After: {answer.text}")
            self.counts["repetitions"] += 1
            time.sleep(0.05)

    def _engine(self, kind: str, rows: dict[int, list[float]], wanted: Counter[str], receipt: dict[str, Any]) -> None:
        """Compare a receipt with what its rows deserve."""
        said: Counter[str] = Counter(refusal["code"] for refusal in receipt["refused"])
        said["stored"] = receipt["accepted"] + receipt["duplicates"]
        if said != wanted or receipt["received"] != len(rows) or receipt["durable"] is not True:
            self.faults.append(f"{kind}: {receipt} where {dict(wanted)} was deserved")
        refused = {refusal["index"] for refusal in receipt["refused"]}
        kept = {epoch_us: powers for position, (epoch_us, powers) in enumerate(rows.items()) if position not in refused}
        with self.lock:
            self.acknowledged.update(kept)
        self.counts.update(
            {"received": len(rows), "accepted": receipt["accepted"], "duplicates": receipt["duplicates"]}
            | {"late": receipt["late"], "refused": len(refused), kind: 1}
        )


def text_of(epoch_us: int) -> str:
    """Return an epoch as the interface writes it."""
    seconds, micros = divmod(epoch_us, 1_000_000)
    return time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(seconds)) + f".{micros:06d}Z"


def start_clients(url: str, key: str, plan_id: int, seed: int, clients: int = 4) -> list[ChaosClient]:
    """Return running clients."""
    made = [ChaosClient(url, key, plan_id, number, clients, seed) for number in range(clients)]
    for client in made:
        client.start()
    return made


def set_up(client: httpx.Client, spacecraft: dict[str, Any], carriers: list[dict[str, Any]]) -> int:
    """Store spacecraft and carriers and return the number of the plan."""
    assert client.post(BASE, json=spacecraft).status_code == 201
    return int(client.put(f"{BASE}/sim-1/carriers", json={"carriers": carriers}).json()["plan_id"])


def promised(clients: list[ChaosClient]) -> dict[tuple[str, int], list[float]]:
    """Return every row that a client was told is stored, by source and epoch."""
    rows: dict[tuple[str, int], list[float]] = {}
    for client in clients:
        with client.lock:
            rows |= {(client.source, epoch_us): powers for epoch_us, powers in client.acknowledged.items()}
    return rows


def finish(clients: list[ChaosClient], timeout_s: float = 120.0) -> Counter[str]:
    """Stop clients, demand that none met a fault, and return what they counted."""
    for client in clients:
        client.stop()
    for client in clients:
        client.join(timeout_s)
    assert [client.faults for client in clients] == [[]] * len(clients)
    assert not any(client.is_alive() for client in clients)
    return sum((client.counts + client.codes for client in clients), Counter())


def history(client: httpx.Client, spacecraft_id: str = "sim-1", **window: str) -> list[dict[str, Any]]:
    """Return the whole history, page after page."""
    rows: list[dict[str, Any]] = []
    params: dict[str, Any] = {**WINDOW, **window, "limit": 10_000}
    while True:
        answer = client.get(f"{BASE}/{spacecraft_id}/measurements/history", params=params)
        page = answer.raise_for_status().json()
        rows += page["rows"]
        if page["next"] is None:
            return rows
        params["cursor"] = page["next"]


def await_consumed(client: httpx.Client, wanted: dict[tuple[str, int], list[float]], timeout_s: float = 120.0) -> None:
    """Wait until the chain has made exactly one row of each method for every row of the prime source."""
    sources = client.get(f"{BASE}/sim-1/sources").json()["rows"]
    prime = next(each["id"] for each in sources if each["role"] == "prime")
    epochs = Counter(text_of(epoch_us) for source, epoch_us in wanted if source == prime)
    deadline = time.monotonic() + timeout_s
    made: Counter[str] = Counter()
    while made != epochs and time.monotonic() < deadline:
        time.sleep(0.1)
        params = {"format": "csv", "method": "paper", **WINDOW}
        table = client.get(f"{BASE}/sim-1/archive/attitude:export", params=params, timeout=120).text
        lines = csv.DictReader(line for line in table.splitlines() if not line.startswith("#"))
        made = Counter(line["epoch"] for line in lines)
    if made != epochs:
        stored = {row["epoch"] for row in history(client) if row["source"] == prime}
        missing = sorted((epochs - made).keys())
        lost = [epoch for epoch in missing if epoch not in stored]
        message = f"{made.total()} results of {epochs.total()} rows, beyond {made - epochs}; without result: {missing}"
        raise AssertionError(f"{message}; of these not in the archive: {lost}")
    assert client.get("/readyz").status_code == 200


def compare(client: httpx.Client, wanted: dict[tuple[str, int], list[float]]) -> dict[str, int]:
    """Demand that history, samples and export tell exactly the wanted rows; return the counts of each."""
    rows = history(client)
    reported = Counter((row["source"], row["epoch"]) for row in rows)
    assert reported == Counter((source, text_of(epoch_us)) for source, epoch_us in wanted), difference(reported, wanted)
    table = client.get(
        f"{BASE}/sim-1/archive/measurements:export", params={"format": "csv", **WINDOW}, timeout=120
    ).text
    lines = list(csv.DictReader(line for line in table.splitlines() if not line.startswith("#")))
    exported = Counter((line["source"], line["epoch"]) for line in lines)
    assert exported == reported
    params = {**WINDOW, "quantity": "power_dbm", "count": 50}
    samples = client.get(f"{BASE}/sim-1/samples", params=params, timeout=120).json()
    sampled = {each["carrier"]: sum(each["n"]) for each in samples["series"]}
    assert set(sampled.values()) == {len(wanted)}, sampled
    return {"history": len(rows), "export": len(lines), "samples": len(wanted)}


def difference(reported: Counter[tuple[str, str]], wanted: dict[tuple[str, int], list[float]]) -> str:
    """Return in words how what is told differs from what was promised."""
    names = {(source, text_of(epoch_us)) for source, epoch_us in wanted}
    doubled = [name for name, times in reported.items() if times > 1]
    missing, beyond = sorted(names - set(reported)), sorted(set(reported) - names)
    return f"of {len(names)} missing {missing}, beyond {beyond}, doubled {doubled}"


def kill_server(cluster: Any) -> None:
    """Kill a PostgreSQL server and all its children with SIGKILL."""
    postmaster = int((cluster.data / "postmaster.pid").read_text().split()[0])
    children = [pid for pid, parent in _parents().items() if parent == postmaster]
    for pid in (postmaster, *children):
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    deadline = time.monotonic() + 120
    while _parents().keys() & {postmaster, *children} and time.monotonic() < deadline:
        time.sleep(0.01)


def start_server(cluster: Any) -> None:
    """Start a PostgreSQL server; it may have to wait for what the killed one has left."""
    for _ in range(20):
        try:
            cluster.start(fsync=True)
        except subprocess.CalledProcessError:
            time.sleep(0.5)
        else:
            return
    message = "the server does not start again"
    raise AssertionError(message)


def _parents() -> dict[int, int]:
    """Return the parent of every process that still runs."""
    found = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            state, parent = path.read_text().rpartition(")")[2].split()[:2]
            if state != "Z":
                found[int(path.parent.name)] = int(parent)
    return found
