"""Fuzzed rows through the real ingest, held against an oracle that shares no code with it.

Each source sends from a thread of its own: several plans, duplicates, conflicts, bad values, leap seconds, zeros of
either sign, rows out of order; the service is killed meanwhile, and what got no answer is sent again unchanged. Seed:
SOO_FUZZ_SEED, printed.
"""

import os
import signal
import threading
import time
from collections import Counter
from datetime import datetime, timedelta

import httpx
import pytest
from ingest_oracle import DETAILS, Fuzzer, Oracle, singles

pytestmark = [pytest.mark.system, pytest.mark.slow]
BASE = "/api/v1/spacecraft/sim-1"
SOURCES = ("sa-1", "sa-2", "sa-3", "sa-4")
WIDTHS = {1: 5, 2: 5, 3: 3}
SEED = os.environ.get("SOO_FUZZ_SEED", "1")
#: a client gives up then: nothing answers any more
PATIENCE_S = 600.0


class Sender(threading.Thread):
    """One source: sends what its fuzzer draws, and compares every receipt with what the oracle says."""

    def __init__(self, source, rows, url_of):
        super().__init__(name=source, daemon=True)
        self.oracle = Oracle(WIDTHS)
        self.counts = Counter()
        self.fault = None
        self._fuzzer = Fuzzer(SEED, source, WIDTHS)
        self._rows, self._url_of = rows, url_of

    def run(self):
        """Send; a fault is kept for the test."""
        try:
            while self.counts["rows"] < self._rows:
                self._send(self._fuzzer.batch())
        except Exception as error:  # noqa: BLE001 - told by the test, in its own thread
            self.fault = f"{self.name}: {error!r}"

    def _send(self, sent):
        deserved = Counter(self.oracle.account(sent))
        answer, is_again = self._answer(sent.body)
        if sent.problem is not None:
            codes = {answer.json().get("code"), *(error["code"] for error in answer.json().get("errors", []))}
            assert answer.status_code in {404, 422}, answer.text
            assert sent.problem in codes, (answer.text, sent.problem)
            self.counts[sent.problem] += 1
            return
        assert answer.status_code == 200, answer.text
        said = answer.json()
        reported = Counter({"accepted": said["accepted"], "duplicate": said["duplicates"]})
        reported.update(refusal["code"] for refusal in said["refused"])
        # without an answer nobody knows whether the rows were stored the first time
        for counter in (reported, deserved) if is_again else ():
            counter["stored"] = counter.pop("accepted", 0) + counter.pop("duplicate", 0)
        assert +reported == +deserved, (sent.body["plan_id"], reported, deserved)
        self.counts.update(deserved)
        self.counts["time.leap_second"] += sum(each["code"] == "time.leap_second" for each in said["flagged"])
        self.counts["seq.jump"] += sum(each["code"] == "seq.jump" for each in said["flagged"])
        self.counts["rows"] += len(sent.epochs)
        self.counts["again"] += is_again

    def _answer(self, body):
        """Return the answer to a request, and whether it was sent again."""
        deadline, is_again = time.monotonic() + PATIENCE_S, False
        headers = {"Authorization": "Bearer a-key-for-tests-only"}
        while time.monotonic() < deadline:
            try:
                url = f"{self._url_of()}{BASE}/measurements:batch"
                answer = httpx.post(url, json=body, headers=headers, timeout=60.0, trust_env=False)
            except httpx.HTTPError:
                is_again = True
                time.sleep(0.05)
                continue
            if answer.status_code != 503 and answer.status_code != 429:
                return answer, is_again
            is_again = True
            time.sleep(0.1)
        raise TimeoutError(body["source"])


def stored_rows(client):
    """Return what the history holds, by source and epoch, in the form of the oracle."""
    found, cursor = {source: {} for source in SOURCES}, None
    while True:
        query = {"start": "2000-01-01T00:00:00Z", "stop": "2100-01-01T00:00:00Z", "limit": 1000}
        answer = client.get(f"{BASE}/measurements/history", params=query | ({"cursor": cursor} if cursor else {}))
        assert answer.status_code == 200, answer.text
        for row in answer.json()["rows"]:
            epoch = datetime.fromisoformat(row["epoch"])
            epoch_us = (epoch - datetime.fromisoformat("1970-01-01T00:00:00Z")) // timedelta(microseconds=1)
            details = [None if row[name] is None else singles(list(row[name].values())) for name in DETAILS.values()]
            flags = None if row["flags"] is None else tuple(row["flags"].values())
            content = (row["plan_id"], singles(list(row["power_dbm"].values())), flags, tuple(details))
            assert epoch_us not in found[row["source"]], "a row stands twice"
            found[row["source"]][epoch_us] = content, row["seq"]
        cursor = answer.json()["next"]
        if cursor is None:
            return found


@pytest.mark.parametrize(("rows", "kills"), [(1500, 1), pytest.param(20_000, 8, marks=pytest.mark.nightly)])
def test_fuzzed_rows_are_stored_counted_and_refused_as_an_oracle_says(start_service, spacecraft, carriers, rows, kills):
    print(f"seed {SEED}")
    arguments = ("--port", "0", "--clock", "system")
    services = [start_service(*arguments)]
    with services[0].client() as client:
        assert client.post("/api/v1/spacecraft", json=spacecraft | {"simulated": False}).status_code == 201
        for plan in (carriers[:5], carriers[4::-1], carriers[:3]):
            assert client.put(f"{BASE}/carriers", json={"carriers": plan}).status_code == 200
    urls = [services[0].url]
    senders = [Sender(source, rows // len(SOURCES), lambda: urls[-1]) for source in SOURCES]
    for sender in senders:
        sender.start()
    for number in range(kills):
        share = (number + 1) / (kills + 1)
        while sum(each.counts["rows"] for each in senders) < share * rows and all(s.fault is None for s in senders):
            time.sleep(0.02)
        services[-1].end(signal.SIGKILL)
        services.append(start_service(*arguments))
        urls.append(services[-1].url)
    for sender in senders:
        sender.join(PATIENCE_S)
    assert [sender.fault for sender in senders] == [None] * len(senders)
    assert not any(sender.is_alive() for sender in senders)
    totals = sum((sender.counts for sender in senders), Counter())
    print(dict(totals))
    assert {"accepted", "duplicate", "measurement.conflict", "value.count", "value.out_of_range"} <= set(totals)
    assert totals["time.leap_second"] > 0
    assert totals["seq.jump"] > 0
    with services[-1].client() as client:
        found = stored_rows(client)
    for sender in senders:
        wanted = {us: (content, sender.oracle.seqs[us]) for us, content in sender.oracle.rows.items()}
        assert found[sender.name].keys() == wanted.keys()
        assert {us: found[sender.name][us][0] for us in wanted} == {us: each[0] for us, each in wanted.items()}
        assert {us: found[sender.name][us][1] for us in wanted} == {us: each[1] for us, each in wanted.items()}
