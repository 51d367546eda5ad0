"""Kill -9 of the service that makes smoothed rows, beside another: none is doubled or missing, all are of one run."""

import random
import re
import time

import pytest
from busy_station import MINUTE, SC, Station, at, text

from db.maintenance.doctor import diagnose
from db.storage import SqlStorage
from service.pipeline.config import ChainConfig
from service.pipeline.estimation.smoothed import GRID_US, grid_us
from service.ports.archive import SMOOTHED, ListPart
from service.records.calibration import Window
from service.records.catalogue import Method
from service.records.epoch import US_PER_S, format_epoch
from service.runtime.clock import system_now_us
from service.runtime.jobs.smoothing import LaggedRun

pytestmark = [pytest.mark.system, pytest.mark.slow, pytest.mark.timeout(900), pytest.mark.nightly]

SEED = 31
LAG_MIN = 20
PIECES = ((1, 40), (40, 75), (75, 110), (110, 140))
SETTINGS = {
    "SOO_BOOTSTRAP_KEY": "a-key-for-tests-only",
    "SOO_SMOOTHING__LAG_S": str(60 * LAG_MIN),
}


def rows_of(minutes, powers):
    """Return the body of a batch."""
    rows = [
        {"epoch": format_epoch(at(minute)), "power_dbm": [round(power, 3) for power in row]}
        for minute, row in zip(minutes, powers.tolist(), strict=True)
    ]
    return {"plan_id": 1, "source": "sa-1", "measurements": rows}


def made_from(url):
    """Return the rows that the archive holds, and those that one run over all of it makes."""
    storage = SqlStorage(url)
    try:
        window = Window(at(-100), at(1000))
        stored = storage.results.attitude_rows(SC, SMOOTHED, Method.ROBUST_SMOOTHED, ListPart(window, 10_000))
        order = LAG_MIN * MINUTE, grid_us(at(0) + GRID_US - 1), storage.archive.head(SC).consumed_number
        return stored, [*LaggedRun(storage, ChainConfig(), SC, *order).steps()][-1].rows
    finally:
        storage.close()


def lag_s(client):
    """Return how far the series is behind the newest row, as the metrics tell it."""
    found = re.search(rf'soo_smoothed_lag_seconds{{spacecraft="{SC}"}} (\S+)', client.get("/metrics").text)
    return None if found is None else float(found[1])


def test_rows_over_kills_of_the_leading_service_are_those_of_one_run_to_the_bit(start_service, tmp_path, url):
    print(f"seed {SEED}")
    instants = random.Random(SEED)
    station = Station(tmp_path, url)
    station.open()
    station.align(-30, 0)
    powers = {piece: station.powers(range(*piece)) for piece in PIECES}
    station.close()
    options = ("--port", "0", "--clock", "data", "--database", url)
    services = [start_service(*options, environment=SETTINGS) for _ in range(2)]
    for number, piece in enumerate(PIECES):
        leading = number % 2
        with services[leading].client() as client:
            answer = client.post(
                f"/api/v1/spacecraft/{SC}/measurements:batch", json=rows_of(range(*piece), powers[piece])
            )
            assert answer.status_code == 200, answer.text
        # before, while and after the worker makes a part
        time.sleep(instants.uniform(0.5, 9.0))
        services[leading].process.kill()
        services[leading].process.wait()
        services[leading] = start_service(*options, environment=SETTINGS)
    newest = grid_us(at(139) - LAG_MIN * MINUTE) - GRID_US
    with services[0].client() as client:
        deadline = time.monotonic() + 300
        rows = []
        while not rows or rows[0]["epoch"] <= format_epoch(newest):
            assert time.monotonic() < deadline, "the series does not reach the lag"
            time.sleep(0.5)
            rows = client.get(f"/api/v1/spacecraft/{SC}/attitude/smoothed", params={"order": "desc"}).json()["rows"]
        assert 60 * LAG_MIN <= lag_s(client) < 60 * LAG_MIN + GRID_US / US_PER_S
    assert [service.end()[0] for service in services] == [0, 0]
    stored, whole = made_from(url)
    assert len(stored) == len(rows) > 15
    assert text(stored) == text(whole)
    assert all("Traceback" not in service.written() for service in services)
    assert [each for each in diagnose(url, system_now_us(), lambda _: None) if each.state == "fault"] == []
