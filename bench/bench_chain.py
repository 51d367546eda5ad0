"""Time of one row through the chain: measurement in, attitude and torque command out, nothing stored.

Run ``python -m bench.bench_chain``. The payload is synthetic (``tests/fakes``): every carrier is calibrated and used,
white noise of 0.05 dB, the craft moves slowly. Figures only; no goal hangs on them.
"""

import argparse
import statistics
import time
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from service.pipeline.chain import Chain
from service.pipeline.config import ChainConfig
from tests.fakes.synthetic_payload import HOUR, MINUTE, START_US, FixedDocuments, SyntheticPayload, opening

#: rows before the clock starts, so that every trailing mean is full
_SETTLING = 60


class StepFigures(NamedTuple):
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
        figures = measure(carriers, options.steps)
        print(
            f"  {carriers} carriers: median {1e3 * figures.median_s:.2f} ms, 99 % below {1e3 * figures.p99_s:.2f} ms, "
            f"{1 / figures.median_s:.0f} rows/s"
        )
    return True


def measure(carriers: int, steps: int, seed: int = 5) -> StepFigures:
    """Return the time of one step."""
    payload = SyntheticPayload.make(carriers, seed)
    aligned_us = START_US + HOUR
    chain = Chain(FixedDocuments(payload, aligned_us), ChainConfig())
    for content in opening(payload.spacecraft()):
        chain.learn(content)
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
    timed = sorted(taken[_SETTLING:])
    return StepFigures(carriers, statistics.median(timed), timed[int(0.99 * (len(timed) - 1))])


if __name__ == "__main__":
    main()
