"""Odd archives: a calibration by geometry ends with figures or with words, never with another exception."""

from dataclasses import replace

import numpy as np
import pytest
from geometry_payload import GeometryPayload

from service.pipeline.calibration.geometry_calibration import calibrate_geometry
from service.pipeline.calibration.windows import CalibrationError
from service.pipeline.config import CalibrationConfig
from service.records.catalogue import Station, Track

SEED = 3


def powers(data, change):
    parts = [replace(part, power_dbm=change(part.power_dbm.copy())) for part in (data.quiet, data.turns)]
    return replace(data, quiet=parts[0], turns=parts[1])


def holes(data, share):
    rng = np.random.default_rng(SEED)
    return powers(data, lambda power: np.where(rng.random(power.shape) < share, np.nan, power))


def thinned(data, step):
    parts = [
        replace(part, epochs_us=part.epochs_us[::step], power_dbm=part.power_dbm[::step])
        for part in (data.quiet, data.turns)
    ]
    return replace(data, quiet=parts[0], turns=parts[1])


def angles(data, change):
    reported = [
        tuple(replace(one, attitude_deg=change(one.attitude_deg.copy())) for one in series)
        for series in (data.references, data.quiet_references)
    ]
    return replace(data, references=reported[0], quiet_references=reported[1])


def tracked(data, start, stop):
    reported = data.ephemeris.track
    cut = slice(start, stop)
    track = Track(reported.epochs_us[cut], reported.latitude_deg[cut], reported.longitude_deg[cut])
    return replace(data, ephemeris=replace(data.ephemeris, track=track))


def carriers(data, change):
    plan = replace(data.plan, carriers=tuple(change(k, one) for k, one in enumerate(data.plan.carriers)))
    return replace(data, plan=plan)


def wild(power):
    return power + 10.0 * np.random.default_rng(SEED).normal(size=power.shape)


#: name, change, and the words of a refusal or None for figures
CASES = {
    "no noise at all": (lambda _: GeometryPayload.make(6, quiet_days=0.5).data(0.0, 0.0), None),
    "powers that never change": (lambda data: powers(data, lambda power: np.full_like(power, -42.0)), None),
    "powers of noise": (lambda data: powers(data, wild), None),
    "half of the samples": (lambda data: holes(data, 0.5), None),
    "one sample in thirty": (lambda data: holes(data, 0.97), None),
    "one sample in two hundred": (lambda data: holes(data, 0.995), "carriers can be used"),
    "rows of three minutes": (lambda data: thinned(data, 3), None),
    "rows of five minutes": (lambda data: thinned(data, 5), "the quiet window holds 144 measurements"),
    "angles that never change": (lambda data: angles(data, np.zeros_like), "no turn of at least 0.1 deg in roll"),
    "a yaw that nobody tells": (
        lambda data: angles(data, lambda reported: np.where([True, False, False], np.nan, reported)),
        "only 0 rows of the quiet window have angles",
    ),
    "a track of three points": (lambda data: tracked(data, 0, 3), None),
    "an empty track": (lambda data: tracked(data, 0, 0), None),
    "a track of another time": (lambda data: tracked(data, 0, 40), None),
    "one station for all": (
        lambda data: carriers(data, lambda _, one: replace(one, station=Station(55.0, 60.0))),
        None,
    ),
    "beacons only": (
        lambda data: carriers(data, lambda _, one: replace(one, station=None, kind="beacon")),
        "only 0 carriers can be used",
    ),
    "one transponder under level control": (
        lambda data: carriers(data, lambda _, one: replace(one, transponder="T", transponder_mode="alc")),
        None,
    ),
    "a band for two carriers": (lambda data: carriers(data, lambda k, one: replace(one, band=f"B{k % 3}")), None),
    "one window for both": (
        lambda data: replace(data, quiet=data.turns, request=replace(data.request, quiet=data.request.turns)),
        "the quiet window holds 0 measurements",
    ),
}


@pytest.fixture(scope="module")
def data():
    """Half a quiet day of six carriers."""
    return GeometryPayload.make(6, quiet_days=0.5).data()


@pytest.mark.parametrize("name", CASES)
def test_figures_or_words(data, name):
    change, refusal = CASES[name]
    if refusal is not None:
        with pytest.raises(CalibrationError, match=refusal):
            calibrate_geometry(change(data), CalibrationConfig())
        return
    result = calibrate_geometry(change(data), CalibrationConfig())
    fit = result.geometry
    used = np.array(fit.is_used)
    assert np.count_nonzero(used) >= 4
    for table in (fit.level_dbm, fit.daily, fit.gradient, fit.hessian, fit.covariance, fit.solar_day_db):
        assert np.isfinite(np.array(table)[used]).all()
    assert all(np.isfinite(carrier.sigma_white_db) and carrier.sigma_white_db > 0.0 for carrier in result.carriers)
    assert result.warnings, "twelve hours are short, whatever else"
