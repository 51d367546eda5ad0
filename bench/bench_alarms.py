"""Cost of alarms per row: readings and limits of every condition, against the step of the chain that made the row.

Run ``python -m bench.bench_alarms``. Both are timed on the same rows of the same run, one after the other, so their
ratio does not depend on the machine's mood. Both methods run on a payload of real places (``tests/fakes``) with white
noise of 0.05 dB and C/N0 beside the powers. ``quiet``: nothing alarms, as nearly always. ``storm``: every second
carrier is away by 7 dB, the others after an hour, and so on. Asked: less than 5 % of a step while nothing alarms.
"""

import argparse
import statistics
import time
from dataclasses import replace

import numpy as np

from service.pipeline.alarms.alarm_engine import AlarmEngine
from service.pipeline.alarms.conditions import condition_table
from service.pipeline.alarms.readings import RowReader
from service.pipeline.chain import Chain
from service.pipeline.config import AlarmConfig, ChainConfig, RobustConfig
from service.records.levels.measurement import CarrierDetails
from service.records.operations.alarm_memory import EngineMemory
from tests.fakes.worlds.geometry_flight import Flight, FlightPayload

ASKED_SHARE = 0.05
#: rows before the clock starts, so that every trailing mean is full
_SETTLING = 60


def main() -> bool:
    """Print the cost of a row for 16 and 32 carriers; return whether it is as small as asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=1000)
    options, _ = parser.parse_known_args()
    is_small = True
    print("alarms of one row")
    for carriers in (16, 32):
        for is_storm in (False, True):
            step_s, alarms_s, changes = measure(carriers, options.steps, is_storm=is_storm)
            share = alarms_s / step_s
            is_small &= is_storm or share <= ASKED_SHARE
            print(
                f"  {carriers} carriers, {'storm' if is_storm else 'quiet'}: {1e6 * alarms_s:.0f} us, "
                f"{100 * share:.1f} % of a step of {1e3 * step_s:.2f} ms, {changes} changes"
            )
    return is_small


def measure(carriers: int, steps: int, *, is_storm: bool, seed: int = 5) -> tuple[float, float, int]:
    """Return the median times of a step and of the alarms of its row, s, and how many changes there were."""
    flight = Flight(FlightPayload.make(carriers, seed), is_opened=False)
    # compiled kernels, as in operation: with those of numpy a step is longer and the share smaller
    chain = Chain(flight.documents, ChainConfig(kernels="numba"))
    for content in flight.opening():
        chain.update(content)
    reader = RowReader(AlarmEngine("craft", condition_table(AlarmConfig(), RobustConfig())), EngineMemory())
    noise = 0.05 * np.random.default_rng(seed).normal(size=(_SETTLING + steps, carriers))
    c_n0 = np.full(carriers, 85.0, dtype=np.float32)
    details = CarrierDetails(c_n0, c_n0, c_n0, c_n0)
    chain_s, alarms_s, changes = [], [], 0
    for row, noise_db in enumerate(noise, start=1):
        away_db = 7.0 * ((np.arange(carriers) + row // 60) % 2) if is_storm else 0.0
        measurement = replace(flight.changed(row, noise_db - away_db), details=details)
        began = time.perf_counter()
        outcome = chain.step(measurement)
        stepped = time.perf_counter()
        changes += len(reader.read_row(chain.facts(measurement, outcome)))
        alarms_s.append(time.perf_counter() - stepped)
        chain_s.append(stepped - began)
        assert outcome is not None
        assert len(outcome.rows) == 2
    return statistics.median(chain_s[_SETTLING:]), statistics.median(alarms_s[_SETTLING:]), changes


if __name__ == "__main__":
    main()
