"""Polarimeter beside the receiving antenna: two ports of a feed turned by d0, what each row's ratio of them reports.

    D = 20 lg |tan(d0 + p + F + r + t) + e|      p  turn of the body against the Earth about the line of sight
                                                 F  Faraday rotation, r rain at the site, t turn of the feed
                                                 e  leakage: constant, wave of a day, wander of hours

D dB; p, F, r, t deg. The co-polar power falls with the rain at the site.
"""

from typing import NamedTuple

import numpy as np

from analyzer_sim.epochs import US_PER_DAY, US_PER_H, US_PER_S
from analyzer_sim.streams import FloatArray, daily_wave, first_order, stream
from analyzer_sim.world.orbit import EpochArray, Orbit, body_from_orbital, orbital_from_earth, station_position_km, unit
from analyzer_sim.world.payload.carriers import Station
from analyzer_sim.world.scenario.story import PolarimeterFigures, Scenario

#: name of the polarimeter, its frequency and the field along the downlink, T
SOURCE = "polarimeter-1"
FREQUENCY_HZ = 11.2e9
FIELD_T = 4.0e-5
#: turn by 3 dB of rain at the site, deg, either way, and correlation time of the wander of the leakage, s
RAIN_DEG, WANDER_TAU_S = (0.1, 0.3), 4 * 3600.0
#: co-polar power in clear sky, dBm, and its noise, dB
_CLEAR_DBM, _POWER_NOISE_DB = -55.0, 0.1
_TECU = 1e16


class PolarizationReport(NamedTuple):
    """One report; the ground has it at its epoch."""

    reported_us: int
    ratio_db: float
    co_power_dbm: float
    noise_db: float
    tec_tecu: float


def polarization_reports(
    scenario: Scenario,
    seed: int,
    orbit: Orbit,
    site: Station,
    epochs_us: EpochArray,
    attitude_deg: FloatArray,
    fade_db: FloatArray,
) -> tuple[PolarizationReport, ...]:
    """Return one report with each row of attitudes (T, 3) and rain at the site (T,); none without a polarimeter."""
    figures = scenario.polarimeter
    if figures is None:
        return ()
    hours = (epochs_us - scenario.operation_start_us) / US_PER_H
    tec_tecu = _quiet_tec(seed, epochs_us)
    storm = np.where(hours >= figures.storm_from_h, figures.storm_factor, 1.0)
    rotation_deg = _rotation_deg(storm * tec_tecu)
    rng = stream(seed, "polarimeter")
    rain_deg = rng.choice([-1.0, 1.0]) * rng.uniform(*RAIN_DEG) / 3.0 * fade_db
    step_deg = np.where(hours >= figures.feed_turn_from_h, figures.feed_turn_deg, 0.0)
    turn_deg = body_turn_deg(orbit, site, epochs_us, attitude_deg)
    white_deg = figures.white_deg * stream(seed, "polarimeter white").normal(size=len(epochs_us))
    angle = np.radians(figures.feed_offset_deg + turn_deg + rotation_deg + rain_deg + step_deg + white_deg)
    leak = np.radians(_leakage_deg(figures, seed, scenario, epochs_us, hours))
    ratio_db = 20.0 * np.log10(np.abs(np.tan(angle) + leak))
    power_dbm = _CLEAR_DBM - fade_db + _POWER_NOISE_DB * stream(seed, "polarimeter power").normal(size=len(epochs_us))
    slope_db_deg = 0.3032 / np.sin(2.0 * np.radians(figures.feed_offset_deg))
    # what an ionospheric map says of a quiet day: a scale wrong by some percent
    mapped_tecu = tec_tecu * (1.0 + figures.map_error * stream(seed, "polarimeter map").normal())
    columns = zip(epochs_us.tolist(), ratio_db.tolist(), power_dbm.tolist(), mapped_tecu.tolist(), strict=True)
    noise_db = round(float(figures.white_deg * slope_db_deg), 4)
    return tuple(
        PolarizationReport(epoch_us, round(ratio, 4), round(power, 3), noise_db, round(tec, 2))
        for epoch_us, ratio, power, tec in columns
    )


def body_turn_deg(orbit: Orbit, site: Station, epochs_us: EpochArray, attitude_deg: FloatArray) -> FloatArray:
    """Return the turn (T,) of the body about the line from the nominal place to a site, counted from the Earth."""
    site_km = station_position_km(site.latitude_deg, site.longitude_deg, site.height_m)
    line_of_sight = unit(site_km - orbit.nominal_km)
    nominal = orbital_from_earth(orbit.nominal_km[None, :], np.array([[0.0, 0.0, 1.0]]))[0]
    body = body_from_orbital(attitude_deg) @ orbit.orbital_from_earth(epochs_us)
    turn = np.swapaxes(body, 1, 2) @ nominal
    axis = 0.5 * np.stack(
        [turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]], axis=1
    )
    return np.asarray(np.degrees(axis @ line_of_sight))


def _leakage_deg(
    figures: PolarimeterFigures, seed: int, scenario: Scenario, epochs_us: EpochArray, hours: FloatArray
) -> FloatArray:
    """Return the leakage (T,), deg: its real part, constant, with a wave of a day, with a wander, perhaps drifting."""
    rng = stream(seed, "polarimeter leakage")
    constant = figures.leakage_deg * np.cos(rng.uniform(0.0, 2.0 * np.pi))
    wave = daily_wave(rng, (epochs_us - scenario.start_us) / US_PER_S, figures.daily_deg)
    wander = first_order(rng, len(epochs_us), scenario.row_period_s, figures.wander_deg, WANDER_TAU_S)
    return np.asarray(constant + wave + wander + figures.leak_drift_deg_h * np.maximum(0.0, hours))


def _quiet_tec(seed: int, epochs_us: EpochArray) -> FloatArray:
    """Return the electron content (T,) along the path on quiet days, TECU: low at night, high after noon."""
    rng = stream(seed, "polarimeter ionosphere")
    least, most, peak = rng.uniform(5.0, 8.0), rng.uniform(20.0, 30.0), rng.uniform(0.45, 0.55)
    day = (epochs_us % US_PER_DAY) / US_PER_DAY
    return np.asarray(least + (most - least) * np.maximum(0.0, np.cos(2.0 * np.pi * (day - peak))) ** 1.5)


def _rotation_deg(tec_tecu: FloatArray) -> FloatArray:
    return np.asarray(np.degrees(2.36e4 * FIELD_T * tec_tecu * _TECU / FREQUENCY_HZ**2))
