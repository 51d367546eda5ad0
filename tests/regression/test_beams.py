"""Boresight of a reflector that the Sun bends: what three days of powers and a star tracker tell of it."""

import numpy as np
import pytest
from calibration_world import CalibratedWorld

from service.pipeline.carrier_model.beam_report import HOUR_US, Group, HourlyMeans, WaveCause, beam_report
from service.pipeline.carrier_model.calibrated_arrays import geometry_model
from service.pipeline.carrier_model.expected_level import ExpectedLevel

pytestmark = pytest.mark.slow
SEEDS = (1, 2)
DAYS = 3.0
#: deg, noise of the simulated star tracker
TRACKER_DEG = (0.015, 0.008, 0.008)


def flown(name, seed):
    """Return the report of a world with a working star tracker, and the true shift of its patterns by the hour."""
    one = CalibratedWorld.of(name, seed, DAYS)
    rows = one.world.rows
    epochs_us = one.arrays["epoch_us"]
    chosen = epochs_us >= one.world.scenario.operation_start_us
    fit, at_us = one.result.geometry, epochs_us[chosen]
    expected = ExpectedLevel(geometry_model(fit, one.result.carriers), fit, one.data.ephemeris)
    deviation = one.arrays["power_dbm"][chosen] - np.array([expected(int(at)) for at in at_us])
    angles = rows.attitude_deg[chosen]
    angles = angles + np.random.default_rng(seed).normal(0.0, TRACKER_DEG, angles.shape)
    hour = at_us // HOUR_US
    begins = np.unique(hour)

    def hourly(values, take=np.nanmean):
        return np.array([take(values[hour == k], axis=0) for k in begins])

    hours = HourlyMeans(
        begins * HOUR_US,
        hourly(deviation),
        hourly(np.isfinite(deviation), np.sum),
        hourly(angles),
        hourly(angles[:, 1:], np.ptp).max(axis=1),
    )
    report = beam_report(one.result, fit, one.data.request.quiet, None, hours, Group.BAND)
    return report, hourly(rows.pattern_shift_deg[chosen])


@pytest.mark.parametrize("seed", SEEDS)
def test_a_wave_of_the_boresight_is_recovered(seed):
    report, truth_deg = flown("antenna_wave", seed)
    (antenna,) = report.antennas
    error = antenna.series.boresight_deg - truth_deg
    rms = np.sqrt(np.nanmean(np.square(error), axis=0))
    waves = [antenna.east.daily, antenna.north.daily]
    size = np.array([wave.amplitude_deg for wave in waves])
    print(
        f"seed {seed}: amplitudes {size.round(4)} of 0.0300 0.0200 deg, sigma {[round(w.sigma_deg, 4) for w in waves]}"
    )
    print(f"seed {seed}: hours {rms.round(4)} deg, zero {np.sqrt(np.mean(truth_deg**2, axis=0)).round(4)}")
    # the study's bound; the answer "it does not move" errs by 0.03 and 0.02
    np.testing.assert_allclose(size, [0.03, 0.02], atol=0.008)
    # the study's live figure is 0.021 and 0.014
    assert (rms < [0.021, 0.016]).all()
    assert antenna.cause is WaveCause.ANTENNA_OR_SENSOR


def test_a_still_antenna_shows_no_wave():
    report, _ = flown("nominal", 1)
    (antenna,) = report.antennas
    print("seed 1:", antenna.east.daily, antenna.north.daily)
    assert antenna.cause is WaveCause.NONE
    assert max(antenna.east.daily.amplitude_deg, antenna.north.daily.amplitude_deg) < 0.012
