"""Kill -9 of a service that makes smoothed rows: none is doubled, none is missing, and all are those of one run."""

import random
import time

import pytest
from busy_station import MINUTE, SC, Station, at, text

from db.connection.sqlite_files import reading_engine
from db.maintenance.integrity_check import examine
from db.storage import SqlStorage
from service.pipeline.config import ChainConfig
from service.pipeline.estimation.smoothed.lagged_rows import GRID_US, grid_us
from service.ports import SMOOTHED
from service.records.calibration import Window
from service.records.catalogue import Method
from service.records.epoch import format_epoch
from service.runtime.jobs.lagged_run import LaggedOrder, LaggedRun

pytestmark = [pytest.mark.system, pytest.mark.slow, pytest.mark.timeout(900)]

SEED = 31
LAG_MIN = 20
PIECES = ((1, 40), (40, 75), (75, 110), (110, 140))
SETTINGS = {
    "SOO_BOOTSTRAP_KEY": "a-key-for-tests-only",
    "SOO_KERNELS": "numpy",
    "SOO_SMOOTHING__LAG_S": str(60 * LAG_MIN),
}


def rows_of(minutes, powers):
    """Return the body of a batch."""
    rows = [
        {"epoch": format_epoch(at(minute)), "power_dbm": [round(power, 3) for power in row]}
        for minute, row in zip(minutes, powers.tolist(), strict=True)
    ]
    return {"plan_id": 1, "source": "sa-1", "measurements": rows}


def made_from(database):
    """Return the rows that the archive holds, and those that one run over all of it makes."""
    storage = SqlStorage(f"sqlite:///{database}")
    try:
        window = Window(at(-100), at(1000))
        stored = storage.results.attitude_rows(SC, SMOOTHED, Method.ROBUST_SMOOTHED, window, 10_000, None)
        order = LaggedOrder(grid_us(at(0) + GRID_US - 1), storage.archive.head(SC).consumed_number, LAG_MIN * MINUTE)
        return stored, LaggedRun(storage, ChainConfig(kernels="numpy"), SC, order).run().rows
    finally:
        storage.close()


def test_rows_over_kills_are_those_of_one_run_to_the_bit(start_service, tmp_path):
    print(f"seed {SEED}")
    instants = random.Random(SEED)
    station = Station(tmp_path)
    station.open()
    station.align(-30, 0)
    powers = {piece: station.powers(range(*piece)) for piece in PIECES}
    station.close()
    options = ("--port", "0", "--clock", "data")
    service = start_service(*options, environment=SETTINGS)
    for piece in PIECES:
        with service.client() as client:
            answer = client.post(
                f"/api/v1/spacecraft/{SC}/measurements:batch", json=rows_of(range(*piece), powers[piece])
            )
            assert answer.status_code == 200, answer.text
        # before, while and after the worker makes a part
        time.sleep(instants.uniform(0.5, 9.0))
        service.process.kill()
        service.process.wait()
        service = start_service(*options, environment=SETTINGS)
    newest = grid_us(at(139) - LAG_MIN * MINUTE) - GRID_US
    with service.client() as client:
        deadline = time.monotonic() + 300
        rows = []
        while not rows or rows[0]["epoch"] <= format_epoch(newest):
            assert time.monotonic() < deadline, "the series does not reach the lag"
            time.sleep(0.5)
            rows = client.get(f"/api/v1/spacecraft/{SC}/attitude/smoothed", params={"order": "desc"}).json()["rows"]
    service.end()
    stored, whole = made_from(tmp_path / "soo.db")
    assert len(stored) == len(rows) > 15
    assert text(stored) == text(whole)
    assert "Traceback" not in service.written()
    with reading_engine(tmp_path / "soo.db").connect() as connection:
        assert [each for each in examine(connection, lambda _: None) if each.state != "ok"] == []
