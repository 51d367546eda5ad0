"""Quiet days: daily change, calm hours, and hours that look like turns."""

import numpy as np
import pytest

from service.pipeline.calibration.minute_rows import minute_rows
from service.pipeline.planning.quiet_days import (
    ALLAN_SPANS_S,
    QuietDays,
    calmest_window,
    quiet_levels,
    sidereal_orbit,
    suspected_turns,
)
from service.records.catalogue import Carrier, CarrierPlan, Site, Spacecraft, Station
from service.records.levels.series import MeasurementSeries

START_US = 1_795_219_200_000_000
HOUR_US = 3_600_000_000
EPOCHS_US = START_US + 60_000_000 * np.arange(4320, dtype=np.int64)
#: yaw, roll, pitch of twelve carriers, dB/deg
SLOPE = np.random.default_rng(3).normal(0.0, [0.15, 1.4, 1.2], (12, 3))
NOISE_DB = np.random.default_rng(4).normal(0.0, 0.15, (4320, 12))


def hours(first: float, last: float) -> slice:
    return slice(round(first * 60), round(last * 60))


def test_the_daily_change_is_removed() -> None:
    carriers = tuple(Carrier(f"c{k:02d}", "Ku", "Ku1", 11.2e9, 1e6, Station(50.0 + k, 80.0)) for k in range(12))
    spacecraft = Spacecraft("s", "s", 90.0, Site(55.0, 38.0), ((1, 0, 0), (0, 1, 0), (0, 0, 1)), 0.05)
    orbit = sidereal_orbit(START_US, int(EPOCHS_US[-1]))
    daily_db = 0.3 * np.cos(2.0 * np.pi * (EPOCHS_US - START_US) / 86_164.0905e6 + 1.0)
    series = MeasurementSeries(tuple(c.id for c in carriers), EPOCHS_US, -72.0 + daily_db[:, np.newaxis] + NOISE_DB)
    plan = CarrierPlan(1, "", carriers)
    levels = quiet_levels(QuietDays(spacecraft, plan, orbit, minute_rows([series], plan.carrier_ids, ())))
    for fit in levels.harmonics:
        assert fit.law == "two_harmonics"
        assert fit.harmonic.amplitude_db == pytest.approx(0.3, abs=0.02)
    assert levels.residual_db.std(axis=0) == pytest.approx(np.full(12, 0.15), rel=0.05)
    assert levels.allan_db.shape == (len(ALLAN_SPANS_S), 12)
    assert levels.allan_db[0] == pytest.approx(np.full(12, 0.15), rel=0.1)


def test_calm_hours_are_found_between_weather_and_gaps() -> None:
    residual = NOISE_DB.copy()
    residual[hours(0, 30), :6] -= 2.0
    residual[hours(45, 72), 3:9] = np.nan
    found = calmest_window(EPOCHS_US, residual, round(8.5 * HOUR_US))
    assert found.start_us >= START_US + 30 * HOUR_US
    assert found.stop_us <= START_US + 45 * HOUR_US


def test_a_dead_carrier_does_not_matter() -> None:
    residual = NOISE_DB.copy()
    residual[:, 4] = np.nan
    residual[hours(0, 60)] *= 3.0
    assert calmest_window(EPOCHS_US, residual, 8 * HOUR_US).start_us >= START_US + 60 * HOUR_US


def test_turns_are_suspected_and_dated() -> None:
    residual = NOISE_DB.copy()
    residual[hours(20, 21)] += SLOPE @ [0.0, 0.4, 0.0]
    residual[hours(21, 22)] += SLOPE @ [0.0, 0.0, -0.3]
    (found,) = suspected_turns(EPOCHS_US, residual, SLOPE)
    assert (found.window.start_us - START_US) / HOUR_US == pytest.approx(20.0, abs=0.2)
    assert (found.window.stop_us - START_US) / HOUR_US == pytest.approx(22.0, abs=0.2)
    assert found.reach_deg == pytest.approx(0.4, abs=0.05)


def test_weather_and_noise_are_no_turns() -> None:
    residual = NOISE_DB.copy()
    residual[hours(5, 9), :3] -= 3.0  # rain over three stations
    residual[hours(30, 33)] -= 2.0  # rain over the receiving site
    residual[hours(50, 60), 7] += 1.5  # a user that stepped
    assert suspected_turns(EPOCHS_US, residual, SLOPE) == ()
    assert suspected_turns(EPOCHS_US, residual, np.full((12, 3), np.nan)) == ()
