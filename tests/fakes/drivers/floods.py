"""Floods against a service on this machine, each a process of its own: bounded in number and in time.

``python floods.py NAME URL KEY SPACECRAFT SECONDS`` floods until the time is over, or its standard input is closed, and
prints how many requests had which status (0: no answer) as JSON.
"""

import gzip
import json
import os
import socket
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from urllib.parse import urlsplit

import httpx

ADDRESS = "127.0.0.2"
#: requests of a flood at most
MOST_REQUESTS = 100_000


class Flood:
    """What all floods know."""

    def __init__(self, url: str, key: str, spacecraft: str, seconds: float) -> None:
        self.url, self.spacecraft = url, spacecraft
        self.headers = {"Authorization": f"Bearer {key}"}
        self.until = time.monotonic() + seconds
        self.counts: Counter[int] = Counter()
        self.over = threading.Event()

    def goes_on(self) -> bool:
        """Return whether time and number are not used up."""
        return not self.over.is_set() and time.monotonic() < self.until and self.counts.total() < MOST_REQUESTS

    def by_requests(self, clients: int, pause_s: float, send: Callable[[httpx.Client], httpx.Response]) -> None:
        """Send requests from several clients until the flood is over."""

        def work() -> None:
            transport = httpx.HTTPTransport(local_address=ADDRESS)
            with httpx.Client(base_url=self.url, transport=transport, timeout=120, trust_env=False) as client:
                while self.goes_on():
                    try:
                        self.counts[send(client).status_code] += 1
                    except httpx.HTTPError:
                        self.counts[0] += 1
                    time.sleep(pause_s)

        threads = [threading.Thread(target=work, daemon=True) for _ in range(clients)]
        for thread in threads:
            thread.start()
        while self.goes_on():
            time.sleep(0.05)

    def silence(self) -> None:
        """1000 connections that say nothing, opened again when they are closed."""
        target = urlsplit(self.url)
        held: list[socket.socket] = []
        while self.goes_on():
            for _ in range(1000 - len(held)):
                try:
                    one = socket.create_connection((target.hostname, target.port), 10, source_address=(ADDRESS, 0))
                except OSError:
                    self.counts[0] += 1
                    continue
                one.setblocking(False)
                held.append(one)
            still = []
            for one in held:
                try:
                    heard = one.recv(4096)
                except BlockingIOError:
                    still.append(one)
                    continue
                except OSError:
                    heard = b""
                self.counts[int(heard[9:12] or 0)] += 1
                one.close()
            held = still
            time.sleep(0.5)

    def gzip_bodies(self) -> None:
        """8 kB that unpack to 8 MB of powers."""
        row = b'{"epoch":"2026-11-21T03:00:00Z","power_dbm":[' + b"0," * 4_000_000 + b"0]}"
        content = gzip.compress(b'{"plan_id":1,"measurements":[' + row + b"]}")
        headers = {**self.headers, "Content-Encoding": "gzip", "Content-Type": "application/json"}
        path = f"/api/v1/spacecraft/{self.spacecraft}/measurements:batch"
        self.by_requests(4, 0.1, lambda client: client.post(path, content=content, headers=headers))

    def wrong_keys(self) -> None:
        """Wrong keys, 480 within seconds and on."""
        headers = {"Authorization": "Bearer wrong"}
        self.by_requests(4, 0.02, lambda client: client.get("/api/v1/spacecraft", headers=headers))

    def exports(self) -> None:
        """Exports of all rows as CSV, the first of which would compile."""
        path = f"/api/v1/spacecraft/{self.spacecraft}/archive/measurements:export"
        self.by_requests(2, 0.2, lambda client: client.get(path, params={"format": "csv"}, headers=self.headers))

    def samples(self) -> None:
        """40 viewers at a time that want all there is of ten thousand intervals."""
        path = f"/api/v1/spacecraft/{self.spacecraft}/samples"
        query = {"quantity": ["power_dbm", "c_n0_db_hz"], "count": 10_000}
        self.by_requests(40, 0.1, lambda client: client.get(path, params=query, headers=self.headers))

    def streams(self) -> None:
        """600 live streams at once."""
        target = urlsplit(self.url)
        head = (
            f"GET /api/v1/spacecraft/{self.spacecraft}/stream HTTP/1.1\r\nHost: x\r\n"
            f"Authorization: {self.headers['Authorization']}\r\n\r\n"
        ).encode()
        held = []
        for _ in range(600):
            one = socket.create_connection((target.hostname, target.port), 300, source_address=(ADDRESS, 0))
            one.sendall(head)
            held.append(one)
        for one in held:
            self.counts[int(one.recv(4096)[9:12] or 0)] += 1
        while self.goes_on():
            time.sleep(0.1)


def main() -> None:
    """Flood and tell what was answered."""
    name, url, key, spacecraft, seconds = sys.argv[1:]
    # the service under test has the same two processors
    os.nice(5)
    flood = Flood(url, key, spacecraft, float(seconds))
    threading.Thread(target=lambda: (sys.stdin.read(), flood.over.set()), daemon=True).start()
    getattr(flood, name)()
    print(json.dumps(flood.counts), flush=True)
    os._exit(0)


if __name__ == "__main__":
    main()
