"""Time of one row through the chain: measurement in, attitude and torque command out, nothing stored.

Run ``python -m bench.bench_chain``. The payload is synthetic (``tests/fakes``): every carrier is calibrated and used,
white noise of 0.05 dB. The robust method runs alone without torques, then both methods with torques; the step of the
robust filter alone follows, with both sets of kernels. Times are processor times, in milliseconds and as a ratio to a
yardstick of the same run, a linear system of 91 unknowns solved for 91 right sides by numpy, because the machine's
speed changes from minute to minute. The mean holds what one row in ten costs more. What momentum of the wheels, rates
of the body and a polarimeter add to a row of the robust method is the ratio of two chains that take the same rows in
turns. Figures only; no goal hangs on them.
"""

import argparse
import math
import statistics
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from service.core.estimation.filtering.attitude_filter import start, step
from service.core.estimation.filtering.filter_model import FilterSettings, no_motion
from service.core.estimation.filtering.rows.row_kernels import ARRAYS, RowKernels, compiled_kernels
from service.pipeline.chain import METHODS, Chain
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
from tests.fakes.worlds.filter_models import aligned, carrier_model
from tests.fakes.worlds.geometry_flight import HOUR, MINUTE, START_US, FlightDocuments, FlightPayload

_CHOICES: tuple[Literal["numpy", "numba"], ...] = ("numpy", "numba")
#: methods of a chain, and whether it computes torques
_CHAINS: dict[str, tuple[Sequence[Method], bool]] = {
    "robust method, no torque": ((Method.ROBUST,), False),
    "both methods and torque": (METHODS, True),
}
#: rows before the clock starts, so that every trailing mean is full
_SETTLING = 60


class StepTimes(NamedTuple):
    """Processor time of a step, s."""

    median_s: float
    mean_s: float
    p99_s: float
    #: of the fixed piece of work right after, s
    yardstick_s: float


def main() -> bool:
    """Print the time of a step for 16 and 32 carriers."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=1500)
    options, _ = parser.parse_known_args()
    for name, (methods, has_commands) in _CHAINS.items():
        print(f"one row through the chain, {name}")
        for choice in _CHOICES:
            for carriers in (16, 32):
                figures = measure(carriers, options.steps, choice, methods, has_commands=has_commands)
                _show(f"{carriers} carriers, {choice}", figures)
    print("one step of the robust filter: carriers of three coloured parts, two common ones")
    sets = {"numpy": ARRAYS, "numba": compiled_kernels()}
    for name, kernels in sets.items():
        for carriers in (16, 32):
            _show(f"{carriers} carriers, {name}", measure_filter(carriers, options.steps, kernels))
    print("one row of the robust method with wheels, rates and a polarimeter over the same without")
    for choice in _CHOICES:
        median, mean = measured_motion_ratio(32, options.steps, choice)
        print(f"  32 carriers, {choice}: median {median:.2f}, mean {mean:.2f}")
    return True


def _show(what: str, figures: StepTimes) -> None:
    """Print one line."""
    median, mean = figures.median_s / figures.yardstick_s, figures.mean_s / figures.yardstick_s
    print(
        f"  {what}: median {1e3 * figures.median_s:.2f} ms ({median:.2f} of the yardstick), mean {mean:.2f} of it, "
        f"99 % below {1e3 * figures.p99_s:.2f} ms, {1 / figures.mean_s:.0f} rows/s"
    )


def yardstick_s(repeats: int = 40) -> float:
    """Return the median processor time of a fixed piece of work, s."""
    draw = np.random.default_rng(1).normal(size=(91, 91))
    matrix, taken = draw @ draw.T + np.eye(91), []
    for _ in range(repeats):
        began = time.thread_time()
        np.linalg.solve(matrix, draw)
        taken.append(time.thread_time() - began)
    return statistics.median(taken)


def measure_filter(carriers: int, steps: int, kernels: RowKernels, seed: int = 5) -> StepTimes:
    """Return the time of one step of the robust filter."""
    model, settings = carrier_model(carriers, components=3, common=2), FilterSettings()
    state, taken = start(model, START_US, aligned(model)), []
    for row, row_db in enumerate(_deviations_db(carriers, steps, seed), start=1):
        began = time.thread_time()
        reported = step(model, settings, state, START_US + row * MINUTE, row_db, no_motion(), kernels=kernels)
        taken.append(time.thread_time() - began)
        state = reported.state
    return _figures(taken)


def _deviations_db(carriers: int, steps: int, seed: int) -> np.ndarray:
    """Return rows of noise, those before the clock starts included."""
    return np.random.default_rng(seed).normal(0.0, 0.17, (_SETTLING + steps, carriers))


def _figures(taken: list[float]) -> StepTimes:
    """Return the figures of some times, those of the first rows left out."""
    timed = sorted(taken[_SETTLING:])
    p99_s = timed[int(0.99 * (len(timed) - 1))]
    return StepTimes(statistics.median(timed), statistics.fmean(timed), p99_s, yardstick_s())


def measured_motion_ratio(
    carriers: int, steps: int, kernels: Literal["numpy", "numba"], seed: int = 5
) -> tuple[float, float]:
    """Return the median and the mean time of a row with all sensors over those without; records are part of the row."""
    payload, rng = FlightPayload.make(carriers, seed), np.random.default_rng(seed)
    plain, sensed = (
        _chain(payload, spacecraft, kernels) for spacecraft in (payload.spacecraft(), _sensed(payload.spacecraft()))
    )
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
    figures = _figures(taken[True]), _figures(taken[False])
    return figures[0].median_s / figures[1].median_s, figures[0].mean_s / figures[1].mean_s


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
    kernels: Literal["numpy", "numba"],
    methods: Sequence[Method] = (Method.ROBUST,),
    *,
    has_commands: bool = False,
) -> Chain:
    """Return a chain that is aligned an hour after the start."""
    documents = FlightDocuments(payload, START_US + HOUR, (0.0, 0.0, 0.0))
    chain = Chain(documents, ChainConfig(kernels=kernels), None, methods, has_commands=has_commands)
    changes = (PlanChange(1), EphemerisChange(1), CalibrationActivation(1, 1), AlignmentSet(1))
    for content in (SpacecraftChange(spacecraft, 1), *changes):
        chain.update(content)
    return chain


def measure(
    carriers: int,
    steps: int,
    kernels: Literal["numpy", "numba"],
    methods: Sequence[Method],
    *,
    has_commands: bool,
    seed: int = 5,
) -> StepTimes:
    """Return the time of one step of a chain."""
    payload = FlightPayload.make(carriers, seed)
    aligned_us = START_US + HOUR
    chain = _chain(payload, payload.spacecraft(), kernels, methods, has_commands=has_commands)
    noise = 0.05 * np.random.default_rng(seed).normal(size=(_SETTLING + steps, carriers))
    taken, fixes = [], 0
    for row, noise_db in enumerate(noise, start=1):
        angles_deg = 0.2 * np.sin(row / np.array([90.0, 70.0, 50.0]))
        exact = payload.measurement(aligned_us + row * MINUTE, angles_deg, number=row)
        exact = replace(exact, power_dbm=(exact.power_dbm + noise_db).astype(np.float32).astype(np.float64))
        began = time.thread_time()
        outcome = chain.step(exact)
        taken.append(time.thread_time() - began)
        assert outcome is not None
        fixes += bool(np.isfinite(outcome.rows[0].attitude_deg.roll))
    # a row that is left without an angle costs less; nearly all must have one for the figure to mean anything
    assert fixes > 0.9 * len(noise), f"only {fixes} of {len(noise)} rows have an angle"
    return _figures(taken)


if __name__ == "__main__":
    main()
