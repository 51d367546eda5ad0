"""Clock, unit and sensor of a calibration against its powers: what is refused, at what sigma, and what is not.

``python -m pytest -s -m nightly tests/regression/test_turns_check.py`` prints the table of docs/evidence/turns.md.
"""

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from calibration_world import calibration_input, ground_of

from analyzer_sim.world.scenario.scenario import scenario_named
from analyzer_sim.world.world import World
from service.core.estimation.calibration.turns import LONGEST_LAG_S
from service.pipeline.calibration.geometry_calibration import calibrate_geometry
from service.pipeline.calibration.paper_calibration import calibrate_paper
from service.pipeline.config import CalibrationConfig
from service.records.calibration import MotionVerdict
from service.records.levels.measurement import MeasurementSeries

CONSISTENT, CONTRADICTED = MotionVerdict.CONSISTENT, MotionVerdict.CONTRADICTED
#: days after the turns, so that powers that lag by hours are all there
AFTER_DAYS = 0.6
#: s, lags of the powers, and whether each is refused; None = it lies at the limit
LAGS = {
    0.0: False,
    30.0: False,
    120.0: None,
    300.0: True,
    900.0: True,
    -890.0: True,
    18_000.0: True,
    -18_000.0: True,
}
#: angles sent over degrees, and the unit that a refusal names
SCALES = {1.2: "", 1e3 * math.pi / 180.0: "mrad", 3600.0: "arcsec"}
HONEST = (
    *(("weather_turns", seed) for seed in range(1, 13)),
    *((name, seed) for name in ("weather_near", "weather_wet_season", "weather_far") for seed in range(1, 5)),
    *((name, seed) for name in ("nominal", "flicker_hard", "many32", "few8") for seed in (1, 2)),
    *((name, 1) for name in ("drift", "dual_band", "nominal_10s", "nominal_300s", "alc", "beacons", "white", "upc")),
)


@lru_cache(maxsize=1)
def flown(name, seed):
    """Return the input of a calibration and all its powers, as an archive has them."""
    ground = ground_of(World(scenario_named(name, operation_days=AFTER_DAYS), seed))
    data = calibration_input(ground)
    return data, MeasurementSeries(data.quiet.carrier_ids, ground.epochs_us, ground.power_dbm)


def calibrated(data, powers, *, lag_s=0.0, scale=1.0, angles=None, calibrate=calibrate_geometry):
    """Return the check of a calibration whose powers are late, whose angles are scaled or others."""

    def cut(start_us, stop_us):
        epochs_us = powers.epochs_us + int(lag_s * 1e6)
        inside = (epochs_us >= start_us) & (epochs_us < stop_us)
        return MeasurementSeries(powers.carrier_ids, epochs_us[inside], powers.power_dbm[inside])

    def sent(series):
        changed = series.attitude_deg if angles is None else angles(series.attitude_deg)
        return replace(series, attitude_deg=scale * changed, sigma_deg=scale * series.sigma_deg)

    quiet, turns, reach_us = data.request.quiet, data.request.turns, int(LONGEST_LAG_S * 1e6)
    late = replace(
        data,
        quiet=cut(quiet.start_us, quiet.stop_us),
        turns=cut(turns.start_us, turns.stop_us),
        around=cut(turns.start_us - reach_us, turns.stop_us + reach_us),
        references=tuple(map(sent, data.references)),
        quiet_references=tuple(map(sent, data.quiet_references)),
    )
    return calibrate(late, CalibrationConfig())


def require_lag(lag_s, seeds, calibrate=calibrate_geometry):
    """Print what the checks say of a lag, and hold it to twelve seconds and to what is refused."""
    checks = [calibrated(*flown("nominal", seed), lag_s=lag_s, calibrate=calibrate).turns for seed in seeds]
    lags, sigmas = (np.array([getattr(one, name) for one in checks]) for name in ("lag_s", "lag_sigma_s"))
    refused = sum(one.verdict is CONTRADICTED for one in checks)
    print(
        f"| {lag_s:.0f} s | {np.mean(lags):.1f} | {np.max(np.abs(lags - lag_s)):.1f} | {np.median(sigmas):.1f} | "
        f"{np.median(np.abs(lags) / sigmas):.0f} | {refused} of {len(checks)} |"
    )
    assert lags == pytest.approx(np.full(len(lags), lag_s), abs=12.0)
    side = "ahead of" if lag_s < 0 else "behind"
    for check in checks:
        assert LAGS[lag_s] in (None, bool(check.reason)), check.reason
        assert not check.reason or f"{side} the star tracker" in check.reason


@pytest.mark.parametrize("lag_s", [30.0, pytest.param(-890.0, marks=pytest.mark.slow)])
def test_a_lag_is_found_and_named(lag_s):
    require_lag(lag_s, (1,))


def by_paper(data, config):
    """Return the calibration by the published method of days without angles, as it may have them."""
    return calibrate_paper(replace(data, quiet_references=()), config)


@pytest.mark.slow
def test_a_lag_is_found_by_the_paper_method():
    require_lag(900.0, (1,), by_paper)


@pytest.mark.nightly
@pytest.mark.parametrize("calibrate", [calibrate_geometry, by_paper])
@pytest.mark.parametrize("lag_s", list(LAGS))
def test_lags_over_seeds(lag_s, calibrate):
    require_lag(lag_s, range(1, 21), calibrate)


def scale_figures(seeds):
    found = {scale: [] for scale in SCALES}
    for seed in seeds:
        data, powers = flown("nominal", seed)
        for scale in SCALES:
            found[scale].append(calibrated(data, powers, scale=scale).turns)
    for scale, checks in found.items():
        scales, sigmas = (np.array([getattr(one, name) for one in checks]) for name in ("scale", "scale_sigma"))
        refused = sum(one.verdict is CONTRADICTED for one in checks)
        print(
            f"| {scale:.5g} | {scales.min():.3g} to {scales.max():.3g} | {np.median(sigmas):.2f} | "
            f"{np.median(np.abs(np.log(scales)) / sigmas):.0f} | {refused} of {len(checks)} |"
        )
    return found


def require_scales(found):
    for scale, checks in found.items():
        for check in checks:
            # beams of the world are no parabolas: curvatures come out 15 % too large
            assert 0.6 < check.scale / scale < 1.1
            assert (f"are the references in {SCALES[scale]}?" in check.reason) == bool(SCALES[scale]), check.reason


@pytest.mark.slow
def test_a_unit_is_found_and_named():
    require_scales(scale_figures((1,)))


@pytest.mark.nightly
def test_units_over_seeds():
    require_scales(scale_figures(range(1, 21)))


@pytest.mark.parametrize("how", ["another spacecraft", pytest.param("roll stands still", marks=pytest.mark.slow)])
def test_another_sensor_is_named_and_rain_is_not(how):
    def angles(attitude_deg):
        if how == "another spacecraft":
            return attitude_deg[::-1]
        return attitude_deg * [1.0, 0.0, 1.0] + np.random.default_rng(1).normal(0.0, 0.008, attitude_deg.shape)

    data, powers = flown("nominal", 1)
    result = calibrated(data, powers, angles=angles)
    print(how, result.turns)
    assert "the powers turn otherwise than the star tracker says" in result.turns.reason
    assert result.warnings[0] == f"the turns are inconsistent: {result.turns.reason}"


def require_honest(worlds, calibrate=calibrate_geometry):
    refused = []
    for name, seed in worlds:
        check = calibrated(*flown(name, seed), calibrate=calibrate).turns
        print(
            f"| {name} {seed} | {check.lag_s:.1f} +- {check.lag_sigma_s:.1f} | {check.scale:.2f} +- "
            f"{check.scale * check.scale_sigma:.2f} | {check.scatter:.1f} | {check.shared:.1f} |",
            flush=True,
        )
        if check.verdict is not CONSISTENT:
            refused.append((name, seed, check.reason))
    assert refused == []


@pytest.mark.slow
def test_honest_turns_are_not_refused():
    require_honest([("nominal", 1), ("weather_turns", 12), ("weather_near", 1)])


@pytest.mark.nightly
@pytest.mark.parametrize("calibrate", [calibrate_geometry, by_paper])
@pytest.mark.parametrize("part", range(4))
def test_forty_honest_worlds_are_not_refused(part, calibrate):
    assert len(HONEST) == 40
    require_honest(HONEST[part::4], calibrate)
