"""Levels of the carriers: payload, repeater, dishes, noise, and all that does not depend on the attitude."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analyzer_sim.epochs import US_PER_S
from analyzer_sim.instrument.spectrum import ENBW_PER_RBW
from analyzer_sim.streams import FloatArray, daily_wave, first_order, stream
from analyzer_sim.world.orbit import (
    EpochArray,
    Orbit,
    antenna_frame_deg,
    body_from_orbital,
    dish_motion_deg,
    station_position_km,
)
from analyzer_sim.world.payload.carriers import Beam, Carrier, CarrierPlan, Station
from analyzer_sim.world.payload.effects import Effects
from analyzer_sim.world.scenario.story import Part, RepeaterSettings, Scenario, StationNoise

#: mispointing relative to the half-power width
MISPOINTING_SHARE = (0.06, 0.12)


def mispointing_deg(seed: int, carrier: str, dish_width_deg: float) -> FloatArray:
    """Return the drawn mispointing (2,) of a user's dish, along and across."""
    rng = stream(seed, "dish", carrier)
    size_deg, angle = dish_width_deg * rng.uniform(*MISPOINTING_SHARE), rng.uniform(0.0, 2.0 * np.pi)
    return np.asarray(size_deg * np.array([np.cos(angle), np.sin(angle)]))


def dish_loss_db(motion_deg: FloatArray, offset_deg: FloatArray, width_deg: float) -> FloatArray:
    """Return the loss (T,) of a dish for motions (T, 2), relative to the nominal place.

    Examples
    --------
    >>> float(dish_loss_db(np.array([[0.05, 0.0]]), np.array([0.1, 0.0]), 1.0)[0].round(6))
    0.15
    """
    position = np.sum((motion_deg + offset_deg) ** 2, axis=1) - np.sum(offset_deg**2)
    return np.asarray(12.0 * position / width_deg**2)


def positions_km(stations: Sequence[Station]) -> FloatArray:
    """Return Earth-fixed positions (N, 3)."""
    return np.array([station_position_km(s.latitude_deg, s.longitude_deg, s.height_m) for s in stations])


def plan_positions_km(plan: CarrierPlan) -> FloatArray:
    """Return positions (N + 1, 3) of the plan's stations and, last, of the receiving site."""
    return positions_km([*(carrier.station for carrier in plan.carriers), plan.receiving_site])


def uplink_gain_db(plan: CarrierPlan, azimuth_deg: FloatArray, elevation_deg: FloatArray) -> FloatArray:
    """Return gains (T, N) of each carrier's uplink beam, 0 for a beacon; angles (T, N + 1), the site last."""
    gains = np.zeros((len(azimuth_deg), len(plan.carriers)))
    for k in plan.users:
        beam: Beam = plan.beams[plan.carriers[k].transponder]
        gains[:, k] = beam.gain_db(azimuth_deg[:, k], elevation_deg[:, k])
    return gains


def pattern_gain_db(
    plan: CarrierPlan, azimuth_deg: FloatArray, elevation_deg: FloatArray, shift_deg: FloatArray | None = None
) -> FloatArray:
    """Return gains (T, N): uplink beam of each carrier plus its band's downlink; angles (T, N + 1), the site last.

    `shift_deg` (T, 2) turns the uplink patterns against the body.
    """
    if shift_deg is None:
        uplink = uplink_gain_db(plan, azimuth_deg, elevation_deg)
    else:
        uplink = uplink_gain_db(plan, azimuth_deg - shift_deg[:, :1], elevation_deg - shift_deg[:, 1:])
    site = azimuth_deg[:, -1], elevation_deg[:, -1]
    downlinks = {band: beam.gain_db(*site) for band, beam in plan.downlink_beams.items()}
    return np.asarray(uplink + np.stack([downlinks[carrier.band] for carrier in plan.carriers], axis=1))


def nominal_gain_db(plan: CarrierPlan, orbit: Orbit, attitude_deg: FloatArray) -> FloatArray:
    """Return gains (T, N) for attitudes (T, 3) with the satellite at its nominal place."""
    start = np.array([orbit.start_us])
    still = Orbit(orbit.longitude_deg, orbit.start_us, 0.0, 0.0, 0.0, 0.0, 0.0)
    body_from_earth = body_from_orbital(attitude_deg) @ still.orbital_from_earth(start)
    site_km = np.broadcast_to(orbit.nominal_km, (len(attitude_deg), 3))
    return pattern_gain_db(plan, *antenna_frame_deg(body_from_earth, site_km, plan_positions_km(plan)))


def sensitivity_db_per_deg(plan: CarrierPlan, orbit: Orbit, step_deg: float = 0.01) -> FloatArray:
    """Return the true sensitivities (N, 3) at nominal attitude by central differences, order yaw, roll, pitch."""
    steps = step_deg * np.eye(3)
    gains = nominal_gain_db(plan, orbit, np.concatenate([steps, -steps]))
    return np.asarray((gains[:3] - gains[3:]).T / (2.0 * step_deg))


def flown_gain_db(
    plan: CarrierPlan,
    orbit: Orbit,
    epochs_us: EpochArray,
    attitude_deg: FloatArray,
    shift_deg: FloatArray | None = None,
) -> FloatArray:
    """Return gains (T, N) at attitudes (T, 3) with the satellite where it is; `shift_deg` as in `pattern_gain_db`."""
    return pattern_gain_db(plan, *_antenna_angles_deg(plan, orbit, epochs_us, attitude_deg), shift_deg)


def uplink_change_db(plan: CarrierPlan, orbit: Orbit, epochs_us: EpochArray, attitude_deg: FloatArray) -> FloatArray:
    """Return the change (T, N) of the uplink beams' gain alone: what the satellite's receivers see."""
    angles = _antenna_angles_deg(plan, orbit, epochs_us, attitude_deg)
    start = np.array([orbit.start_us])
    still = Orbit(orbit.longitude_deg, orbit.start_us, 0.0, 0.0, 0.0, 0.0, 0.0)
    nominal = _antenna_angles_deg(plan, still, start, np.zeros((1, 3)))
    return uplink_gain_db(plan, *angles) - uplink_gain_db(plan, *nominal)


def _antenna_angles_deg(
    plan: CarrierPlan, orbit: Orbit, epochs_us: EpochArray, attitude_deg: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return azimuth and elevation (T, N + 1) of the stations and the site in the antenna frame."""
    body_from_earth = body_from_orbital(attitude_deg) @ orbit.orbital_from_earth(epochs_us)
    return antenna_frame_deg(body_from_earth, orbit.position_km(epochs_us), plan_positions_km(plan))


def dishes_loss_db(plan: CarrierPlan, orbit: Orbit, epochs_us: EpochArray, seed: int) -> FloatArray:
    """Return the losses (T, N) of the users' fixed dishes; a beacon has none."""
    satellite_km, nominal_km = orbit.position_km(epochs_us), orbit.nominal_km
    stations_km = plan_positions_km(plan)
    losses = np.zeros((len(epochs_us), len(plan.carriers)))
    for k in plan.users:
        carrier = plan.carriers[k]
        motion = dish_motion_deg(stations_km[k], nominal_km, satellite_km)
        offset = mispointing_deg(seed, carrier.id, carrier.dish_width_deg)
        losses[:, k] = dish_loss_db(motion, offset, carrier.dish_width_deg)
    return losses


def power_control_db(change_db: FloatArray, row_period_s: float, tau_s: float, limit_db: float) -> FloatArray:
    """Return what a station adds (T,) against the change (T,) of its own carrier at the satellite.

    Examples
    --------
    >>> power_control_db(np.array([0.0, -2.0, -2.0]), 1e6, 1.0, 6.0).tolist()
    [0.0, 0.0, 2.0]
    """
    share = -float(np.expm1(-row_period_s / tau_s))
    added, value = [], 0.0
    for change in change_db.tolist():
        added.append(value)
        value = min(limit_db, max(-limit_db, value - share * (change + value)))
    return np.array(added)


def level_control_db(
    arriving_dbm: FloatArray, nominal_dbm: FloatArray, is_on: NDArray[np.bool_], members: list[int]
) -> FloatArray:
    """Return the gain (T,) by which a transponder holds its total power; levels (T, N) and (N,), dBm."""
    power_mw = np.where(is_on[:, members], 10.0 ** (arriving_dbm[:, members] / 10.0), 0.0)
    total_mw = np.sum(power_mw, axis=1)
    nominal_mw = float(np.sum(10.0 ** (nominal_dbm[members] / 10.0)))
    # with nothing on the air there is nothing to hold
    return np.where(total_mw > 0.0, -10.0 * np.log10(np.maximum(total_mw, 1e-30) / nominal_mw), 0.0)


def repeater_db(
    figures: RepeaterSettings,
    plan: CarrierPlan,
    arriving_dbm: FloatArray,
    is_on: NDArray[np.bool_],
    row_period_s: float,
) -> tuple[FloatArray, FloatArray]:
    """Return what power control adds at the stations and what level control adds in the repeater, (T, N) each, dB.

    `arriving_dbm` (T, N) is what reaches the transponders without either.
    """
    levels_dbm = np.array([carrier.level_dbm for carrier in plan.carriers])
    power, level = np.zeros_like(arriving_dbm), np.zeros_like(arriving_dbm)
    for name in figures.power_controlled:
        column = plan.column(name)
        change_db = arriving_dbm[:, column] - levels_dbm[column]
        limits = figures.power_control_tau_s, figures.power_control_limit_db
        power[:, column] = power_control_db(change_db, row_period_s, *limits)
    for transponder in figures.alc_transponders:
        members = [k for k, carrier in enumerate(plan.carriers) if carrier.transponder == transponder]
        level[:, members] = level_control_db(arriving_dbm + power, levels_dbm, is_on, members)[:, None]
    return power, level


#: the sweep for which the plan's white noise is split: RBW, duration
SWEEP_RBW_HZ = 30e3
SWEEP_TIME_S = 2.0
_MIN_WHITE_DB = 0.05
#: what the temperature of the satellite does to a beacon: a typical change from day to day, dB
BEACON_DRIFT_DB_DAY = 0.05
BEACON_TAU_S = 86_400.0


def sweep_sigma_db(plan: CarrierPlan) -> FloatArray:
    """Return the noise (N,) that the default sweep itself adds to each carrier's power, dB.

    `4.343 / sqrt(1.505 RBW T B / span)`, B = symbol rate; of a beacon `4.343 sqrt(2 / (C/N0 t))`, t = the dwell of one
    noise bandwidth.
    """
    dwell_s_hz = SWEEP_TIME_S / (plan.span_hz[1] - plan.span_hz[0])
    sigma = []
    for carrier in plan.carriers:
        c_n0 = 10.0 ** (carrier.c_n0_db_hz / 10.0)
        line = 0.5 * c_n0 * dwell_s_hz * ENBW_PER_RBW * SWEEP_RBW_HZ
        sigma.append(line if carrier.is_beacon else 1.505 * SWEEP_RBW_HZ * dwell_s_hz * carrier.symbol_rate_hz)
    return np.asarray(4.343 / np.sqrt(sigma))


def world_white_db(plan: CarrierPlan) -> FloatArray:
    """Return the white noise (N,) that with the sweep's own share makes up the plan's figure, dB."""
    total = np.array([carrier.white_db for carrier in plan.carriers])
    least = np.array([0.0 if carrier.is_beacon else _MIN_WHITE_DB for carrier in plan.carriers])
    return np.asarray(np.sqrt(np.maximum(total**2 - sweep_sigma_db(plan) ** 2, least**2)))


def chain_noise_db(scenario: Scenario, seed: int, seconds: FloatArray) -> FloatArray:
    """Return the drift (T,) of the receiving chain."""
    figures = scenario.noise
    rng = stream(seed, "chain")
    wave = daily_wave(rng, seconds, figures.chain_daily_db)
    slow = wave + first_order(rng, len(seconds), scenario.row_period_s, figures.chain_db, figures.chain_tau_s)
    return np.asarray(slow + _flicker_db(seed, "chain", figures.chain_flicker, scenario, len(seconds)))


def users_noise_db(plan: CarrierPlan, scenario: Scenario, seed: int, seconds: FloatArray) -> FloatArray:
    """Return the noise (T, N) of all users, and of the beacons."""
    white_db = world_white_db(plan) * scenario.noise.white_scale
    columns = [
        (_beacon_noise_db if carrier.is_beacon else _user_noise_db)(carrier, sigma_db, scenario, seed, seconds)
        for carrier, sigma_db in zip(plan.carriers, white_db.tolist(), strict=True)
    ]
    noise_db = np.stack(columns, axis=1)
    if scenario.noise.station is not None:
        for station, members in plan.columns_by_station.items():
            noise_db[:, members] += _station_noise_db(station, scenario.noise.station, scenario, seed, seconds)[:, None]
    return noise_db


def _station_noise_db(
    name: str, figures: StationNoise, scenario: Scenario, seed: int, seconds: FloatArray
) -> FloatArray:
    """Return the level (T,) of a station in the dry: first-order parts, white noise, wave of the solar day."""
    rng = stream(seed, "station", name)
    drawn = _drawn_station(figures, rng)
    solar = daily_wave(rng, seconds, drawn.daily_db)
    slow = drawn.scale * _flicker_db(seed, f"station {name}", figures.parts, scenario, len(seconds))
    return np.asarray(slow + solar + drawn.white_db * stream(seed, "station white", name).normal(size=len(seconds)))


class _DrawnStation(NamedTuple):
    """Scale of the parts, white noise and amplitude of the solar day of one station."""

    scale: float
    white_db: float
    daily_db: float


def _drawn_station(figures: StationNoise, rng: np.random.Generator) -> _DrawnStation:
    scale = float(np.exp(figures.parts_spread * rng.normal()))
    white_db = figures.white_db * float(np.exp(figures.white_spread * rng.normal()))
    return _DrawnStation(scale, white_db, 0.5 * float(rng.uniform(*figures.solar_db)))


class CarrierNoise(NamedTuple):
    """True statistics of one carrier's noise, dB."""

    #: of a row, without the noise of the sweep
    white_db: float
    parts: tuple[Part, ...]
    #: amplitudes of the waves of the solar day, added in squares
    daily_db: float


def carrier_noise(plan: CarrierPlan, column: int, scenario: Scenario, seed: int) -> CarrierNoise:
    """Return the statistics from which `users_noise_db` draws the noise of a carrier."""
    figures, carrier = scenario.noise, plan.carriers[column]
    white_db = float(world_white_db(plan)[column]) * figures.white_scale
    if carrier.is_beacon:
        return CarrierNoise(white_db, ((_beacon_sigma_db(), BEACON_TAU_S),), 0.0)
    coloured_db = float(stream(seed, "coloured", carrier.id).uniform(*figures.coloured_db))
    scale = float(stream(seed, "flicker scale", carrier.id).uniform(*figures.flicker_scale))
    parts = [(coloured_db, figures.coloured_tau_s), (carrier.wander_db * figures.wander_scale, figures.wander_tau_s)]
    parts += [(scale * sigma_db, tau_s) for sigma_db, tau_s in figures.flicker]
    white2, daily2 = white_db**2 + figures.quantum_db**2 / 12.0, figures.thermal_db**2
    if figures.station is not None:
        drawn = _drawn_station(figures.station, stream(seed, "station", carrier.station.name))
        parts += [(drawn.scale * sigma_db, tau_s) for sigma_db, tau_s in figures.station.parts]
        white2 += drawn.white_db**2 + figures.station.quantum_db**2 / 12.0
        daily2 += drawn.daily_db**2
    return CarrierNoise(white2**0.5, tuple(part for part in parts if part[0] > 0.0), daily2**0.5)


def _beacon_noise_db(
    carrier: Carrier, white_db: float, scenario: Scenario, seed: int, seconds: FloatArray
) -> FloatArray:
    """Return the noise (T,) of a beacon: white, and the drift of the satellite's own transmitter."""
    white = white_db * stream(seed, "white", carrier.id).normal(size=len(seconds))
    rng, step_s = stream(seed, "beacon", carrier.id), scenario.row_period_s
    return np.asarray(white + first_order(rng, len(seconds), step_s, _beacon_sigma_db(), BEACON_TAU_S))


def _beacon_sigma_db() -> float:
    """Return the sigma of a beacon's drift: two values a correlation time apart differ by sigma sqrt(2 - 2 / e)."""
    return BEACON_DRIFT_DB_DAY / float(np.sqrt(2.0 - 2.0 / np.e))


def _user_noise_db(carrier: Carrier, white_db: float, scenario: Scenario, seed: int, seconds: FloatArray) -> FloatArray:
    """Return the noise (T,) of one user: white, coloured, day of temperature, wander, flicker."""
    figures, count, step_s = scenario.noise, len(seconds), scenario.row_period_s
    white = white_db * stream(seed, "white", carrier.id).normal(size=count)
    coloured_rng = stream(seed, "coloured", carrier.id)
    sigma_db = float(coloured_rng.uniform(*figures.coloured_db))
    coloured = first_order(coloured_rng, count, step_s, sigma_db, figures.coloured_tau_s)
    thermal = daily_wave(stream(seed, "thermal", carrier.id), seconds, figures.thermal_db)
    wander_db = carrier.wander_db * figures.wander_scale
    wander = first_order(stream(seed, "wander", carrier.id), count, step_s, wander_db, figures.wander_tau_s)
    scale = float(stream(seed, "flicker scale", carrier.id).uniform(*figures.flicker_scale))
    flicker = scale * _flicker_db(seed, carrier.id, figures.flicker, scenario, count)
    return np.asarray(white + coloured + thermal + wander + flicker)


def _flicker_db(seed: int, name: str, parts: tuple[Part, ...], scenario: Scenario, count: int) -> FloatArray:
    """Return the sum (count,) of first-order parts."""
    total = np.zeros(count)
    for sigma_db, tau_s in parts:
        rng = stream(seed, "flicker", name, f"{tau_s:g} s")
        total += first_order(rng, count, scenario.row_period_s, sigma_db, tau_s)
    return total


#: noise temperature of the receiving site in clear sky and of the rain, K
CLEAR_SKY_K = 120.0
RAIN_K = 270.0


class Levels(NamedTuple):
    """Levels of some rows; (T, N)."""

    carrier_dbm: FloatArray
    #: what stations and transponders add on their own
    power_control_db: FloatArray
    level_control_db: FloatArray


class LevelTerms:
    """The terms of one world.

    Attributes
    ----------
    levels_dbm : FloatArray
        (N,) levels of the plan.
    chain_db, common_db : FloatArray
        (T,) receiving chain; (T, N) the same with the rain over the receiving site.
    """

    def __init__(
        self, scenario: Scenario, seed: int, plan: CarrierPlan, orbit: Orbit, epochs_us: EpochArray, effects: Effects
    ) -> None:
        seconds = (epochs_us - scenario.start_us) / US_PER_S
        self._scenario, self._plan, self._orbit, self._effects = scenario, plan, orbit, effects
        self._epochs_us = epochs_us
        self.levels_dbm = np.array([carrier.level_dbm for carrier in plan.carriers])
        self.chain_db: FloatArray = effects.chain_db + chain_noise_db(scenario, seed, seconds)
        self.common_db: FloatArray = self.chain_db[:, None] - effects.downlink_fade_db[:, None] * plan.rain_share
        self._nominal_db = nominal_gain_db(plan, orbit, np.zeros((1, 3)))
        dish_db = dishes_loss_db(plan, orbit, epochs_us, seed)
        users_db = users_noise_db(plan, scenario, seed, seconds)
        stations_db = users_db - effects.uplink_fade_db
        if scenario.noise.station is not None:
            is_before = epochs_us < scenario.operation_start_us
            stations_db -= np.median(stations_db[is_before], axis=0)
            stations_db = _on_grid(stations_db, scenario.noise.station.quantum_db)
        #: (T, N) levels of the stations with noise and rain, and what is no noise: dishes, steps
        self._stations_db, self._stated_db = stations_db, effects.level_db - dish_db
        self._arriving_db = self._stations_db + self._stated_db
        self._has_shift = bool(np.any(effects.pattern_shift_deg))

    @property
    def has_control(self) -> bool:
        """Return whether stations or transponders steer power: then a row depends on those before it."""
        return bool(self._scenario.repeater.alc_transponders or self._scenario.repeater.power_controlled)

    @property
    def noise_db(self) -> FloatArray:
        """(T, N) noise and rain of stations, chain and receiving site."""
        return np.asarray(self._stations_db + self.common_db - self._effects.chain_db[:, None])

    @property
    def noise_dbm_hz(self) -> FloatArray:
        """(T,) noise density at the analyzer input."""
        rain_k = RAIN_K * (1.0 - 10.0 ** (-self._effects.downlink_fade_db / 10.0))
        rain_db = 10.0 * np.log10((CLEAR_SKY_K + rain_k) / CLEAR_SKY_K)
        return np.asarray(self._plan.noise_dbm_hz + self.chain_db + rain_db + self._effects.sun_noise_db)

    @property
    def interference_dbm(self) -> FloatArray:
        """(T, N) power of interfering lines, NaN = none."""
        return np.asarray(self._effects.interference_db + self.levels_dbm + self.common_db)

    def levels(self, attitude_deg: FloatArray, first: int = 0) -> Levels:
        """Return the levels of the rows from `first` on that have these attitudes (T, 3).

        With power or level control `first` must be 0.
        """
        rows = slice(first, first + len(attitude_deg))
        shift_deg = self._effects.pattern_shift_deg[rows] if self._has_shift else None
        gain_db = flown_gain_db(self._plan, self._orbit, self._epochs_us[rows], attitude_deg, shift_deg)
        power_db, level_db = self._control_db(attitude_deg, rows)
        sent_dbm = self.levels_dbm + (gain_db - self._nominal_db) + self._arriving_db[rows] + power_db + level_db
        return Levels(_on_grid(sent_dbm + self.common_db[rows], self._scenario.noise.quantum_db), power_db, level_db)

    def row_sensitivity_db_per_deg(self, attitude_deg: FloatArray, step_deg: float = 0.01) -> FloatArray:
        """Return the true sensitivities (T, N, 3) at the attitudes (T, 3) of all rows by central differences."""
        shift_deg = self._effects.pattern_shift_deg if self._has_shift else None
        slopes = []
        for step in step_deg * np.eye(3):
            above, below = (
                flown_gain_db(self._plan, self._orbit, self._epochs_us, attitude_deg + sign * step, shift_deg)
                for sign in (1.0, -1.0)
            )
            slopes.append((above - below) / (2.0 * step_deg))
        return np.stack(slopes, axis=-1)

    def noise_free_dbm(self, carrier_dbm: FloatArray) -> FloatArray:
        """Return the levels (T, N) of all rows without noise and rain of stations, chain and receiving site."""
        return np.asarray(carrier_dbm - self.noise_db)

    def measurable_dbm(self, carrier_dbm: FloatArray, first: int = 0) -> FloatArray:
        """Return the power inside each carrier's band, NaN where the carrier is off or nothing is measured."""
        rows = slice(first, first + len(carrier_dbm))
        line_dbm = self._effects.interference_db[rows] + self.levels_dbm + self.common_db[rows]
        line_mw = np.where(np.isnan(line_dbm), 0.0, 10.0 ** (line_dbm / 10.0))
        power_dbm = np.where(line_mw > 0.0, 10.0 * np.log10(10.0 ** (carrier_dbm / 10.0) + line_mw), carrier_dbm)
        is_measured = self._effects.is_on[rows] & ~self._effects.is_gap[rows, None]
        return np.where(is_measured, power_dbm, np.nan)

    def _control_db(self, attitude_deg: FloatArray, rows: slice) -> tuple[FloatArray, FloatArray]:
        """Return what power and level control add (T, N)."""
        arriving_dbm = self.levels_dbm + self._arriving_db[rows]
        if not self.has_control:
            return np.zeros_like(arriving_dbm), np.zeros_like(arriving_dbm)
        arriving_dbm = arriving_dbm + uplink_change_db(self._plan, self._orbit, self._epochs_us[rows], attitude_deg)
        figures, period_s = self._scenario.repeater, self._scenario.row_period_s
        return repeater_db(figures, self._plan, arriving_dbm, self._effects.is_on[rows], period_s)


def _on_grid(level_dbm: FloatArray, quantum_db: float) -> FloatArray:
    """Return levels on whole multiples of a quantum; 0 = as they are."""
    return np.asarray(np.round(level_dbm / quantum_db) * quantum_db) if quantum_db > 0.0 else level_dbm
