"""Processor time of one row: through the attitude filter, and through the chain from measurement to torque command.

Run ``python -m bench.bench_chain``. The payload is synthetic (``tests/fakes``): every carrier is calibrated and used,
white noise of 0.05 dB; nothing is stored. Figures are ratios to a yardstick of the same run, a linear system of 91
unknowns solved for 91 right sides by numpy, because the machine's speed changes from minute to minute; medians of runs
in turns. A row is the mean of many: one in ten costs more. The filter takes blocks of rows, as replays and studies
hand them over, and single ones, as they come live. What momentum of the wheels, rates of the body and a polarimeter
add to a row of the robust method is the ratio of two chains that take the same rows in turns. Figures only; no goal
hangs on them.
"""

import argparse
import math
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from unittest.mock import patch

import numpy as np

from service.core.estimation.filtering.advance import advance
from service.core.estimation.filtering.filter_model import CarrierModel
from service.core.estimation.filtering.filter_state import FilterState, start
from service.core.estimation.filtering.plant import FilterModel, filter_model
from service.core.estimation.filtering.row_block import TAKEN, empty_block, empty_result
from service.pipeline.chain import METHODS, Chain, ChainRow
from service.pipeline.config import ChainConfig
from service.records.catalogue import BodyRateSensor, Method, Polarimeter, Spacecraft, WheelMomentum
from service.records.inputs import (
    AlignmentSet,
    CalibrationActivation,
    EphemerisChange,
    PlanChange,
    PolarizationRecord,
    SpacecraftChange,
    TelemetryRecord,
)
from service.records.levels.attitude import Axes
from service.records.levels.measurement import Measurement
from tests.fakes.worlds.filter_models import aligned, carrier_model
from tests.fakes.worlds.geometry_flight import HOUR, MINUTE, START_US, FlightDocuments, FlightPayload

#: methods of a chain, and whether it computes torques
_CHAINS: dict[str, tuple[Sequence[Method], bool]] = {
    "robust method, no torque": ((Method.ROBUST,), False),
    "both methods and torque": (METHODS, True),
}
#: rows before the clock starts, so that every trailing mean is full
_SETTLING = 60
_BLOCK_ROWS = 1000
#: rows that a chain takes at once, as a replay hands them over
_AT_ONCE = 128
#: correlation times of coloured noise, s, and their sigmas, dB
_TAUS_S, _COLOURED_DB = (300.0, 1200.0, 7200.0, 36000.0), (0.05, 0.07, 0.03, 0.02)


def main() -> bool:
    """Print all figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=1440, help="rows of a run, live and through the chain")
    parser.add_argument("--runs", type=int, default=5)
    options, _ = parser.parse_known_args()
    works = _works(options.steps)
    taken: dict[str, list[tuple[float, float]]] = {name: [] for name in works}
    sensors = []
    for _ in range(options.runs):
        for name, work in works.items():
            # the yardstick right before: the speed of the machine changes
            taken[name].append((yardstick_s(), work()))
        sensors.append(measured_motion_ratio(32, options.steps))
    ruler_s = statistics.median(ruler_s for each in taken.values() for ruler_s, _ in each)
    print(f"one row over the yardstick of {1e3 * ruler_s:.2f} ms of the processor, medians of {options.runs} runs")
    for name, each in taken.items():
        ratio = statistics.median(row_s / ruler_s for ruler_s, row_s in each)
        print(f"  {name}: {ratio:.2f} ({1e3 * statistics.median(row_s for _, row_s in each):.2f} ms)")
    print(f"  chain, robust method, 32 carriers, all sensors over none: {statistics.median(sensors):.2f}")
    return True


def _works(steps: int) -> dict[str, Callable[[], float]]:
    """Return what is timed, by name: functions that return the time of a row, s."""
    works: dict[str, Callable[[], float]] = {}
    for carriers in (8, 16, 32, 64):
        works[f"filter, blocks of {_BLOCK_ROWS} rows, {carriers} carriers"] = partial(block_s, carriers)
    for carriers in (16, 32):
        works[f"filter, live, {carriers} carriers"] = partial(live_s, carriers, steps)
    for name, (methods, has_commands) in _CHAINS.items():
        for carriers, rows in ((16, 1), (32, 1), (16, _AT_ONCE)):
            at_once = "live" if rows == 1 else f"blocks of {rows} rows"
            works[f"chain, {name}, {carriers} carriers, {at_once}"] = partial(
                chain_row_s, carriers, steps, methods, has_commands=has_commands, rows=rows
            )
    return works


def yardstick_s(repeats: int = 40) -> float:
    """Return the median processor time of a fixed piece of work, s."""
    draw = np.random.default_rng(1).normal(size=(91, 91))
    matrix, taken = draw @ draw.T + np.eye(91), []
    for _ in range(repeats):
        began = time.thread_time()
        np.linalg.solve(matrix, draw)
        taken.append(time.thread_time() - began)
    return statistics.median(taken)


@contextmanager
def chain_time() -> Iterator[list[float]]:
    """Give a list whose only element counts the processor time of the steps of every chain, s."""
    plain, spent_s = Chain.rows, [0.0]

    def timed(chain: Chain, measurements: Sequence[Measurement], *, is_catch_up: bool = False) -> list[ChainRow]:
        began_s = time.thread_time()
        rows_out = plain(chain, measurements, is_catch_up=is_catch_up)
        spent_s[0] += time.thread_time() - began_s
        return rows_out

    with patch.object(Chain, "rows", timed):
        yield spent_s


def block_s(carriers: int, seed: int = 5) -> float:
    """Return the mean time of a row of the robust filter that comes with many others."""
    model, state = _filter(carriers)
    rows_db, taken_s = _deviations_db(carriers, _BLOCK_ROWS, seed), 0.0
    for first, rows in ((0, _SETTLING), (_SETTLING, _BLOCK_ROWS)):
        block, result = empty_block(rows, carriers), empty_result(rows, carriers)
        block.rows["epoch_us"] = START_US + MINUTE * np.arange(first + 1, first + rows + 1)
        block.carriers["deviation_db"] = rows_db[first : first + rows]
        began = time.thread_time()
        state = advance(model, state, block, result)
        taken_s = time.thread_time() - began
        assert (result.rows["status"] == TAKEN).all()
    return taken_s / _BLOCK_ROWS


def live_s(carriers: int, steps: int, seed: int = 5) -> float:
    """Return the mean time of a row of the robust filter that comes alone."""
    (model, state), taken = _filter(carriers), []
    for row, row_db in enumerate(_deviations_db(carriers, steps, seed), start=1):
        began = time.thread_time()
        block, result = empty_block(1, carriers), empty_result(1, carriers)
        block.rows["epoch_us"], block.carriers["deviation_db"] = START_US + row * MINUTE, row_db
        state = advance(model, state, block, result)
        taken.append(time.thread_time() - began)
    return statistics.fmean(taken[_SETTLING:])


def _filter(carriers: int) -> tuple[FilterModel, FilterState]:
    """Return carriers of four coloured parts and two common ones, and the state of a filter at its alignment."""
    plain = carrier_model(carriers, components=3, common=2)
    model: CarrierModel = plain._replace(
        coloured_sigma_db=np.tile(_COLOURED_DB, (carriers, 1)), coloured_tau_s=np.tile(_TAUS_S, (carriers, 1))
    )
    return filter_model(model), start(model, START_US, aligned(model))


def _deviations_db(carriers: int, steps: int, seed: int) -> np.ndarray:
    """Return rows of noise, those before the clock starts included."""
    return np.random.default_rng(seed).normal(0.0, 0.17, (_SETTLING + steps, carriers))


def measured_motion_ratio(carriers: int, steps: int, seed: int = 5) -> float:
    """Return the mean time of a row with all sensors over that without; records are part of the row."""
    payload, rng = FlightPayload.make(carriers, seed), np.random.default_rng(seed)
    plain, sensed = (_chain(payload, one) for one in (payload.spacecraft(), _sensed(payload.spacecraft())))
    taken: dict[bool, list[float]] = {False: [], True: []}
    yaw_deg = {False: math.nan, True: math.nan}
    for row in range(1, _SETTLING + steps + 1):
        at_us = START_US + HOUR + row * MINUTE
        exact = payload.measurement(at_us, np.zeros(3), number=row)
        noisy = (exact.power_dbm + rng.normal(0.0, 0.05, carriers)).astype(np.float32).astype(np.float64)
        exact, records = replace(exact, power_dbm=noisy), _records(row, at_us, rng)
        for is_sensed in (True, False) if row % 2 else (False, True):
            began = time.thread_time()
            for record in records if is_sensed else ():
                sensed.update(record)
            outcome = (sensed if is_sensed else plain).step(exact)
            taken[is_sensed].append(time.thread_time() - began)
            assert outcome is not None
            yaw_deg[is_sensed] = outcome.rows[0].sigma_deg.yaw
    assert yaw_deg[True] < 0.7 * yaw_deg[False], f"the sensors are not used: sigma of yaw {yaw_deg} deg"
    return statistics.fmean(taken[True][_SETTLING:]) / statistics.fmean(taken[False][_SETTLING:])


def _sensed(spacecraft: Spacecraft) -> Spacecraft:
    """Return a spacecraft that states its wheels, a rate sensor outside of the loop, and a polarimeter."""
    onboard = replace(spacecraft.onboard, momentum=WheelMomentum(), rate_sensor=BodyRateSensor(False, 0.01, 8.0, 0.003))
    return replace(spacecraft, onboard=onboard, polarimeters=(Polarimeter("p", 10.0, 11e9),))


def _records(row: int, at_us: int, rng: np.random.Generator) -> list[TelemetryRecord | PolarizationRecord]:
    """Return what the sensors tell before a row: momentum each five minutes, the others each minute."""
    wheels = tuple((np.array([0.2, -8.0, 0.1]) + rng.normal(0.0, 0.01, 3)).tolist()) if row % 5 == 0 else None
    rate = Axes(*(np.array([0.0, 0.0, -15.0411 / 3600.0]) + rng.normal(0.0, 1e-6, 3)).tolist())
    angle = PolarizationRecord("p", at_us - MINUTE // 2, angle_deg=1.0 + rng.normal(0.0, 0.05), sigma_deg=0.05)
    return [TelemetryRecord(at_us - MINUTE // 2, wheel_momentum_n_m_s=wheels, body_rate_deg_s=rate), angle]


def _chain(
    payload: FlightPayload,
    spacecraft: Spacecraft,
    methods: Sequence[Method] = (Method.ROBUST,),
    *,
    has_commands: bool = False,
) -> Chain:
    """Return a chain that is aligned an hour after the start."""
    documents = FlightDocuments(payload, START_US + HOUR, (0.0, 0.0, 0.0))
    chain = Chain(documents, ChainConfig(), None, methods, has_commands=has_commands)
    changes = (PlanChange(1), EphemerisChange(1), CalibrationActivation(1, 1), AlignmentSet(1))
    for content in (SpacecraftChange(spacecraft, 1), *changes):
        chain.update(content)
    return chain


def chain_row_s(carriers: int, steps: int, methods: Sequence[Method], *, has_commands: bool, rows: int) -> float:
    """Return the mean time of a row of a chain that takes some rows at once."""
    payload, seed = FlightPayload.make(carriers, 5), 5
    chain = _chain(payload, payload.spacecraft(), methods, has_commands=has_commands)
    noise = 0.05 * np.random.default_rng(seed).normal(size=(_SETTLING + steps, carriers))
    measurements = []
    for row, noise_db in enumerate(noise, start=1):
        angles_deg = 0.2 * np.sin(row / np.array([90.0, 70.0, 50.0]))
        exact = payload.measurement(START_US + HOUR + row * MINUTE, angles_deg, number=row)
        noisy_dbm = (exact.power_dbm + noise_db).astype(np.float32).astype(np.float64)
        measurements.append(replace(exact, power_dbm=noisy_dbm))
    chain.rows(measurements[:_SETTLING])
    taken_s, fixes = 0.0, 0
    for first in range(_SETTLING, len(measurements), rows):
        began = time.thread_time()
        found = chain.rows(measurements[first : first + rows])
        taken_s += time.thread_time() - began
        angles = (each.outcome.rows[0].attitude_deg.roll for each in found if each.outcome is not None)
        fixes += sum(map(math.isfinite, angles))
    # a row that is left without an angle costs less; nearly all must have one for the figure to mean anything
    assert fixes > 0.9 * steps, f"only {fixes} of {steps} rows have an angle"
    return taken_s / steps


if __name__ == "__main__":
    main()
