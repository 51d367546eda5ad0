"""Time of one row through the chain: measurement in, attitude and torque command out, nothing stored.

Run ``python -m bench.bench_chain``. The payload is synthetic (``tests/fakes``): every carrier is calibrated and used,
white noise of 0.05 dB, the spacecraft moves slowly. The step of the robust filter alone follows, with both sets of
kernels. Times are given in milliseconds and as a ratio to a yardstick of the same run, a linear system of 91 unknowns
solved for 91 right sides by numpy, because the machine's speed changes from minute to minute. Figures only; no goal
hangs on them.
"""

import argparse
import statistics
import time
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from service.core.estimation.filtering.attitude_filter import start, step
from service.core.estimation.filtering.filter_predict import Weather, predict
from service.core.estimation.filtering.filter_update import innovate, update
from service.core.estimation.filtering.kernels.kernels import ARRAYS, Kernels, compiled_kernels
from service.core.estimation.filtering.model.filter_model import FilterSettings, no_motion
from service.pipeline.chain import Chain
from service.pipeline.config import ChainConfig
from tests.fakes.worlds.filter_models import aligned, carrier_model
from tests.fakes.worlds.synthetic_payload import HOUR, MINUTE, START_US, FixedDocuments, SyntheticPayload, opening

#: rows before the clock starts, so that every trailing mean is full
_SETTLING = 60


class StepTimes(NamedTuple):
    """Time of a step, s."""

    carriers: int
    median_s: float
    p99_s: float


def main() -> bool:
    """Print the time of a step for 16 and 32 carriers."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=1500)
    options, _ = parser.parse_known_args()
    print("one row through the chain")
    for carriers in (16, 32):
        _show(f"{carriers} carriers", measure(carriers, options.steps))
    print("one step of the robust filter: carriers of three coloured parts, two common ones")
    for carriers in (16, 32):
        _show(f"{carriers} carriers", measure_filter(carriers, options.steps))
    print("prediction and update in it")
    for name, kernels in (("numpy", ARRAYS), ("numba", compiled_kernels())):
        for carriers in (16, 32):
            _show(f"{carriers} carriers, {name}", measure_arithmetic(carriers, options.steps, kernels))
    return True


def _show(what: str, figures: StepTimes) -> None:
    """Print one line."""
    ratio = figures.median_s / yardstick_s()
    print(
        f"  {what}: median {1e3 * figures.median_s:.2f} ms ({ratio:.2f} of the yardstick), 99 % below "
        f"{1e3 * figures.p99_s:.2f} ms, {1 / figures.median_s:.0f} rows/s"
    )


def yardstick_s(repeats: int = 40) -> float:
    """Return the median time of a fixed piece of work, s."""
    draw = np.random.default_rng(1).normal(size=(91, 91))
    matrix, taken = draw @ draw.T + np.eye(91), []
    for _ in range(repeats):
        began = time.perf_counter()
        np.linalg.solve(matrix, draw)
        taken.append(time.perf_counter() - began)
    return statistics.median(taken)


def measure_filter(carriers: int, steps: int, seed: int = 5) -> StepTimes:
    """Return the time of one step of the robust filter."""
    model, settings = carrier_model(carriers, components=3, common=2), FilterSettings()
    state, taken = start(model, START_US, aligned(model)), []
    for row, row_db in enumerate(_deviations_db(carriers, steps, seed), start=1):
        began = time.perf_counter()
        reported = step(model, settings, state, START_US + row * MINUTE, row_db, no_motion())
        taken.append(time.perf_counter() - began)
        state = reported.state
    return _figures(carriers, taken)


def measure_arithmetic(carriers: int, steps: int, kernels: Kernels, seed: int = 5) -> StepTimes:
    """Return the time that prediction and update take of a step."""
    model, settings, used = carrier_model(carriers, components=3, common=2), FilterSettings(), np.arange(carriers)
    state, variance, taken = aligned(model), np.zeros(carriers), []
    for row_db in _deviations_db(carriers, steps, seed):
        weather = Weather(
            is_raining=False,
            is_unannounced=(False, False, False),
            slow_scale=1.0,
            model_variance_db2=variance,
        )
        began = time.perf_counter()
        ahead, variance = predict(model, settings, state, MINUTE, no_motion(), weather, kernels)
        innovation = innovate(model, ahead, row_db, used, model.white_sigma_db**2, kernels=kernels)
        state = update(model, ahead, row_db, innovation, kernels).state
        taken.append(time.perf_counter() - began)
    return _figures(carriers, taken)


def _deviations_db(carriers: int, steps: int, seed: int) -> np.ndarray:
    """Return rows of noise, those before the clock starts included."""
    return np.random.default_rng(seed).normal(0.0, 0.17, (_SETTLING + steps, carriers))


def _figures(carriers: int, taken: list[float]) -> StepTimes:
    """Return the figures of some times, those of the first rows left out."""
    timed = sorted(taken[_SETTLING:])
    return StepTimes(carriers, statistics.median(timed), timed[int(0.99 * (len(timed) - 1))])


def measure(carriers: int, steps: int, seed: int = 5) -> StepTimes:
    """Return the time of one step."""
    payload = SyntheticPayload.make(carriers, seed)
    aligned_us = START_US + HOUR
    chain = Chain(FixedDocuments(payload, aligned_us), ChainConfig())
    for content in opening(payload.spacecraft()):
        chain.update(content)
    noise = 0.05 * np.random.default_rng(seed).normal(size=(_SETTLING + steps, carriers))
    taken, fixes = [], 0
    for row, noise_db in enumerate(noise, start=1):
        angles_deg = 0.2 * np.sin(row / np.array([90.0, 70.0, 50.0]))
        exact = payload.measurement(aligned_us + row * MINUTE, angles_deg, number=row)
        exact = replace(exact, power_dbm=(exact.power_dbm + noise_db).astype(np.float32).astype(np.float64))
        began = time.perf_counter()
        outcome = chain.step(exact)
        taken.append(time.perf_counter() - began)
        assert outcome is not None
        fixes += bool(np.isfinite(outcome.rows[0].attitude_deg.roll))
    # a row that is left without an angle costs less; nearly all must have one for the figure to mean anything
    assert fixes > 0.9 * len(noise), f"only {fixes} of {len(noise)} rows have an angle"
    return _figures(carriers, taken)


if __name__ == "__main__":
    main()
