"""A clock that steps by an hour under the running service, and rows of a leap second: counted, said, never lost.

The service reads time in one module only; here that module reads a clock that the test sets.
"""

import time

import chaos_clients as chaos
import pytest

pytestmark = pytest.mark.system

BASE = "/api/v1/spacecraft"
HOUR_US = 3_600_000_000
#: time.time_ns() of the one module that reads it, moved by what stands in a file
STEPPED = """
import pathlib, time
import service.runtime.clock as clock
class Stepped:
    time_ns = staticmethod(lambda: time.time_ns() + 1000 * int(pathlib.Path({path!r}).read_text()))
clock.time = Stepped
"""


class Bench:
    """A service whose clock can be set, and rows to send it."""

    def __init__(self, client, plan_id, offset, chaos):
        self.client, self._plan_id, self._offset, self._chaos = client, plan_id, offset, chaos
        self._position = 0

    def step(self, hours):
        """Set the clock so many hours off."""
        fresh = self._offset.with_suffix(".new")
        fresh.write_text(str(hours * HOUR_US))
        fresh.replace(self._offset)

    def send(self, hours=0):
        """Send five rows of the last second, on a clock so many hours off; return what was said of them."""
        now_us = time.time_ns() // 1000 + hours * HOUR_US
        self._position += 10
        return self.post([self._chaos.text_of(now_us - 1_000_000 + 10 * k + self._position) for k in range(5)])

    def post(self, epochs):
        """Send rows that differ from one another; return accepted, late and codes of refusals."""
        rows = [{"epoch": epoch, "power_dbm": [-50.0 - position] * 16} for position, epoch in enumerate(epochs)]
        body = {"plan_id": self._plan_id, "source": "sa-1", "measurements": rows}
        answer = self.client.post(f"{BASE}/sim-1/measurements:batch", json=body)
        assert answer.status_code == 200, answer.text
        said = answer.json()
        assert said["received"] == said["accepted"] + said["duplicates"] + len(said["refused"])
        return said["accepted"], said["late"], sorted({refusal["code"] for refusal in said["refused"]})

    def stored(self, **window):
        """Return the epochs of the history."""
        window = window or {"start": "2016-01-01T00:00:00Z", "stop": "2099-01-01T00:00:00Z"}
        answer = self.client.get(f"{BASE}/sim-1/measurements/history", params={**window, "limit": 1000})
        return [row["epoch"] for row in answer.json()["rows"]]


@pytest.fixture
def bench(start_service, spacecraft, carriers, tmp_path):
    """A service under the system's clock, which is right at first."""
    offset = tmp_path / "offset"
    offset.write_text("0")
    (tmp_path / "sitecustomize.py").write_text(STEPPED.format(path=str(offset)))
    environment = {"SOO_BOOTSTRAP_KEY": "a-key-for-tests-only", "PYTHONPATH": str(tmp_path)}
    service = start_service("--port", "0", "--clock", "system", environment=environment)
    with service.client() as client:
        plan_id = chaos.set_up(client, {**spacecraft, "simulated": False}, carriers)
        yield Bench(client, plan_id, offset, chaos)
    assert service.end()[0] == 0
    assert "Traceback" not in service.written()


def test_steps_of_an_hour_and_a_leap_second_cost_no_row(bench):
    assert bench.send() == (5, 0, [])
    bench.step(+1)
    # rows of the right time are an hour old now; the archive keeps them, the estimator does not follow them
    assert bench.send() == (5, 5, [])
    assert bench.send(hours=1) == (5, 0, [])
    bench.step(0)
    # behind what the chain has consumed
    deadline = time.monotonic() + 120
    while bench.client.get(f"{BASE}/sim-1/status").json()["pending"] and time.monotonic() < deadline:
        time.sleep(0.02)
    accepted, late, codes = bench.send()
    assert (accepted, codes) == (5, [])
    assert late in (0, 5)
    bench.step(-1)
    assert bench.send() == (0, 0, ["time.future"])
    assert bench.send(hours=-1)[0] == 5
    bench.step(0)
    assert bench.send()[0] == 5
    epochs = bench.stored()
    assert len(epochs) == len(set(epochs)) == 30
    assert bench.client.get("/readyz").status_code == 200
    # 23:59:60.x stands at 00:00:00.x and gives way by 1 us, for a single row and in a batch of the fast form alike
    second = [f"2016-12-31T23:59:{text}Z" for text in ("59.500000", "60.000000", "60.500000")]
    minute = [f"2017-01-01T00:00:{text}Z" for text in ("00.000000", "00.500000")]
    others = [f"2017-01-01T00:00:{position:02d}.000000Z" for position in range(1, 8)]
    assert bench.post([*second, *minute]) == (5, 5, [])
    assert bench.post([*second[1:2], *others])[0] == 7
    window = {"start": "2016-12-31T23:59:59Z", "stop": "2017-01-01T00:00:08Z"}
    moved = [f"2017-01-01T00:00:00.{text}Z" for text in ("000001", "500001")]
    assert bench.stored(**window) == sorted([second[0], *minute, *moved, *others])
