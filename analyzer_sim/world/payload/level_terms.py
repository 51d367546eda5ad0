"""Level terms: everything in a carrier's level that does not depend on the attitude, and what the attitude adds.

    P_i = level_i + pattern change - dish loss - uplink fade + steps + noise of the user
          + power and level control + receiving chain - downlink fade

The terms are made once for all rows; the attitude may come later, row by row, when a loop is closed.
"""

from typing import NamedTuple

import numpy as np

from analyzer_sim.epochs import US_PER_S
from analyzer_sim.streams import FloatArray
from analyzer_sim.world.orbit.orbit import EpochArray, Orbit
from analyzer_sim.world.payload.carriers import CarrierPlan
from analyzer_sim.world.payload.effects import Effects
from analyzer_sim.world.payload.payload import dishes_loss_db, flown_gain_db, nominal_gain_db, uplink_change_db
from analyzer_sim.world.payload.repeater import repeater_db
from analyzer_sim.world.payload.user_noise import chain_noise_db, users_noise_db
from analyzer_sim.world.scenario.story import Scenario

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
