"""Load of the ingest benchmark: connections that post batches one after another, each batch with epochs of its own.

A request is one join of prepared pieces and one write, so that one process of this can fill the server. Answers are
checked by their bytes: every row of every batch must have been accepted.
"""

import asyncio
import json
import time
from dataclasses import dataclass, field
from typing import NamedTuple
from urllib.parse import urlsplit

#: where the epoch's second goes into the prepared text
_MARK = "@@@@"
#: where the number of the first row goes, and the first number of ten digits
_SEQ_MARK = "##########"
_FIRST_SEQ = 10**9
#: 2027-01-15T08:00:00Z; the data clock follows
_START_S = 1_800_000_000


class Shape(NamedTuple):
    """Shape of the load: rows a request, carriers a row, connections."""

    rows: int
    carriers: int
    connections: int


class Rate(NamedTuple):
    """Requests and times of one measurement."""

    requests: int
    seconds: float
    #: slowest but one in a hundred, s
    p99_s: float

    @property
    def per_second(self) -> float:
        """Requests a second."""
        return self.requests / self.seconds


@dataclass
class Load:
    """Connections to one server that go on where the last measurement ended.

    Parameters
    ----------
    url, key : str
        Address and bearer key.
    plan_id : int
        Carrier plan of the rows.
    shape : Shape
        Rows, carriers and connections.
    """

    url: str
    key: str
    plan_id: int
    shape: Shape
    #: seconds of rows each connection has sent
    sent: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.sent = [0] * self.shape.connections

    async def run(self, seconds: float) -> Rate:
        """Post on all connections for some seconds."""
        until = time.perf_counter() + seconds
        began = time.perf_counter()
        delays = await asyncio.gather(*(self._post(number, until) for number in range(self.shape.connections)))
        elapsed_s = time.perf_counter() - began
        every = sorted(delay for part in delays for delay in part)
        return Rate(len(every), elapsed_s, every[int(0.99 * (len(every) - 1))])

    async def _post(self, number: int, until: float) -> list[float]:
        """Post batches on one connection and return how long each answer took."""
        address = urlsplit(self.url)
        reader, writer = await asyncio.open_connection(address.hostname, address.port)
        opening, *chunks = self._chunks(number)
        accepted = f'"accepted":{self.shape.rows},'.encode()
        delays = []
        try:
            while (began := time.perf_counter()) < until:
                second = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(_START_S + self.sent[number])).encode()
                first_seq = str(_FIRST_SEQ + self.shape.rows * self.sent[number]).encode()
                writer.write(second.join((opening.replace(_SEQ_MARK.encode(), first_seq), *chunks)))
                answer = await _answer(reader)
                if accepted not in answer:
                    raise RuntimeError(f"the server answered {answer[:300]!r}")
                self.sent[number] += 1
                delays.append(time.perf_counter() - began)
        finally:
            writer.close()
        return delays

    def _chunks(self, number: int) -> list[bytes]:
        """Return the parts of a request between the seconds of its epochs."""
        shape = self.shape
        measurements = [
            {
                "epoch": f"{_MARK}.{row * (1_000_000 // shape.rows):06d}Z",
                "power_dbm": [round(-40 - number - row / 100 - carrier / 10, 2) for carrier in range(shape.carriers)],
            }
            for row in range(shape.rows)
        ]
        document = {"plan_id": self.plan_id, "source": f"sa-{number}", "first_seq": 0, "measurements": measurements}
        body = json.dumps(document, separators=(",", ":")).replace('"first_seq":0', f'"first_seq":{_SEQ_MARK}')
        length = len(body) + shape.rows * (len("2027-01-15T08:00:00") - len(_MARK))
        head = (
            "POST /api/v1/spacecraft/bench/measurements:batch HTTP/1.1\r\nHost: bench\r\n"
            f"Authorization: Bearer {self.key}\r\nContent-Type: application/json\r\nContent-Length: {length}\r\n\r\n"
        )
        return (head + body).encode().split(_MARK.encode())


async def _answer(reader: asyncio.StreamReader) -> bytes:
    head = await reader.readuntil(b"\r\n\r\n")
    _, _, rest = head.lower().partition(b"content-length:")
    return head + await reader.readexactly(int(rest.partition(b"\r\n")[0]))
