"""Processor time of restarts after few and after many rows, and of replays of an hour and of everything."""

import time
from contextlib import closing

import numpy as np
import pytest
from busy_station import SC, Station

from db.tables import checkpoint
from service.pipeline.config import ChainConfig
from service.runtime.live.journal_consumer import ChainRestarts

pytestmark = [pytest.mark.slow, pytest.mark.alone, pytest.mark.timeout(1200)]

#: the commands of a week are read at each restart: up to then its cost grows with them
FEW, MANY = 1_000, 8_000
#: what the figures may be on a machine that does other things at the same time, over the goals of `make bench`
SLACK = 2.0


def restart_s(station, restarts=15):
    """Return the least processor time of some restarts: what else runs can only add to it, for seconds at a time."""
    taken, consumed = [], station.storage.archive.head(SC).consumed_number
    for _ in range(restarts):
        began = time.process_time()
        assert ChainRestarts(station.storage, ChainConfig(), lambda: False).chain(SC, consumed) is not None
        taken.append(time.process_time() - began)
        time.sleep(0.3)
    return min(taken)


def replay_s(station, start, stop):
    """Return the processor time of a replay of both methods."""
    began = time.process_time()
    station.replay(start, stop)
    return time.process_time() - began


def test_a_restart_costs_the_same_after_many_rows(tmp_path):
    with closing(Station(tmp_path)) as station:
        station.open()
        times = {}
        with station.supervised() as settle:
            station.align(-30, 0)
            settle()
        for rows, first in ((FEW, 1), (MANY, FEW + 1)):
            with station.supervised() as settle:
                for start in range(first, rows + 1, 100):
                    station.send(range(start, start + 100))
                    settle()
            times[rows] = restart_s(station)
        whole_s, hours_s = replay_s(station, 1, MANY), [replay_s(station, at, at + 60) for at in (1, MANY - 60)]
        by_rows_s = {rows: replay_s(station, 1, rows) for rows in (MANY // 8, MANY // 4, MANY // 2)} | {MANY: whole_s}
        station.storage._database.write(lambda connection: connection.execute(checkpoint.delete()))
        from_alignment_s = restart_s(station, 1)
    ratio = times[MANY] / times[FEW]
    print(
        f"restart after {FEW} rows {1e3 * times[FEW]:.0f} ms, after {MANY} {1e3 * times[MANY]:.0f} ms: {ratio:.2f}; "
        f"from the alignment {from_alignment_s:.1f} s"
    )
    shares = [hour_s / whole_s for hour_s in hours_s]
    print(
        f"replay of {MANY} rows {whole_s:.1f} s; of the first hour {shares[0]:.4f}, of the last {shares[1]:.4f} of it"
    )
    exponent = np.polyfit(np.log(list(by_rows_s)), np.log(list(by_rows_s.values())), 1)[0]
    print(f"a replay grows by the power {exponent:.2f} of its rows")
    # of the chain alone, without the start of the process, which both have: 1.5 of that is the goal of `make bench`
    assert ratio < SLACK * 2.0
    assert times[MANY] < SLACK * from_alignment_s / 100
    # an hour of 133, and what every replay costs
    assert max(shares) < SLACK / 20
    assert exponent <= 1.05 + SLACK * 0.1
