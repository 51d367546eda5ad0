"""Rehearsal of a calibration over quiet days of the simulator: what it predicts and what it refuses."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from service.pipeline.calibration.minute_rows import minute_rows
from service.pipeline.calibration.windows import CalibrationError
from service.pipeline.planning.assumed_beams import NOISES, AssumedBeam, assume_payload
from service.pipeline.planning.quiet_days import QuietDays, quiet_levels
from service.pipeline.planning.rehearsal import Rehearsal, rehearse
from service.records.catalogue import CarrierPlan
from service.study.estimation.flight.world import World, export_world, read_world

#: every fifth row: what is tested here does not need the others
STEP = 5
BEAMS = {
    "Ku1": AssumedBeam(-3.07, 6.81, 4.5, 3.0),
    "Ku2": AssumedBeam(-2.42, 8.60, 4.0, 3.3),
    "Ku3": AssumedBeam(0.07, 8.60, 4.3, 3.2),
    "Ku4": AssumedBeam(3.73, 6.90, 4.5, 3.1),
}


@cache
def world() -> World:
    with TemporaryDirectory() as folder:
        export_world("nominal", 1, Path(folder) / "world.npz", 0.05)
        return read_world(Path(folder) / "world.npz")


def quiet_days(rows: slice = slice(None), extra_db: float = 0.0) -> QuietDays:
    ground = world().ground
    plan = CarrierPlan(1, "", ground.carriers)
    series = ground.series(ground.phases["quiet"], plan.carrier_ids)
    noise = np.random.default_rng(5).normal(0.0, 1.0, series.power_dbm.shape) * extra_db
    kept = replace(series, epochs_us=series.epochs_us[::STEP][rows], power_dbm=(series.power_dbm + noise)[::STEP][rows])
    return QuietDays(ground.spacecraft, plan, ground.ephemeris, minute_rows([kept], plan.carrier_ids, ()))


def rehearsed(days: QuietDays) -> Rehearsal:
    payload = assume_payload(days.plan.carriers, days.spacecraft.longitude_deg, NOISES["links"], BEAMS)
    return rehearse(days, quiet_levels(days), payload.response)


def test_the_turns_come_back_as_the_beams_that_were_stated() -> None:
    days = quiet_days()
    found = rehearsed(days)
    payload = assume_payload(days.plan.carriers, 90.0, NOISES["links"], BEAMS)
    slopes = np.array([carrier.sensitivity_db_per_deg for carrier in found.result.carriers])
    error = np.abs(slopes - payload.response.slope)[:, 1:]
    print(f"slopes of roll and pitch: greatest error {error.max():.2f}, mean {error.mean():.2f} dB/deg")
    # five rows of noise in a level of the turns, and slow noise that is fitted with them
    assert error.max() < 0.5
    assert error.mean() < 0.15
    prediction = found.prediction
    assert 0.01 < prediction.usual_sigma_deg.roll < 0.04
    assert (prediction.protection_deg[:, 1] > 2.0 * prediction.sigma_deg[:, 1]).all()
    assert found.turns.stop_us - found.turns.start_us == round(8.5 * 3.6e9)


@pytest.mark.slow
def test_noisier_days_predict_a_larger_sigma() -> None:
    quiet, noisy = (rehearsed(quiet_days(extra_db=noise)).prediction.usual_sigma_deg for noise in (0.0, 0.6))
    assert noisy.roll > 1.5 * quiet.roll
    assert noisy.pitch > 1.5 * quiet.pitch


@pytest.mark.slow
def test_carriers_without_a_known_beam_do_not_count() -> None:
    days = quiet_days()
    payload = assume_payload(days.plan.carriers, 90.0, NOISES["links"], BEAMS)
    response = payload.response._replace(slope=payload.response.slope.copy())
    response.slope[2] = np.nan
    result = rehearse(days, quiet_levels(days), response).result
    assert result.geometry is not None
    assert [k for k, used in enumerate(result.geometry.is_used) if not used] == [2]


def test_short_days_are_refused() -> None:
    with pytest.raises(CalibrationError, match=r"hold 20\.0 h; three days are wanted, 32\.5 h are the least"):
        rehearsed(quiet_days(slice(0, 241)))


def test_too_few_carriers_are_refused() -> None:
    days = quiet_days()
    days.rows.series.power_dbm[:, 3:] = np.nan
    with pytest.raises(CalibrationError, match=r"only 3 carriers can be used, 4 are needed"):
        rehearsed(days)
