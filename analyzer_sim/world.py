"""World: a scenario and a seed become series of powers at the analyzer input, row by row.

    P_i = level_i + pattern change - dish loss - uplink fade + steps + noise of the user
          + receiving chain - downlink fade

Everything is computed at construction; `advance` only moves a pointer. Rows inside a gap are passed over. A row is
measured at its epoch, the middle of its dwell. After the last row `advance` raises `EndOfScenario`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analyzer_sim.carriers import PLANS, ROLLOFF, Carrier, CarrierPlan
from analyzer_sim.emission import Emission, Signal
from analyzer_sim.epochs import US_PER_S
from analyzer_sim.faults import Effects, FaultFlag, effects_of
from analyzer_sim.noise import daily_wave, first_order
from analyzer_sim.orbit import EpochArray, Orbit
from analyzer_sim.payload import attitude_gain_db, dishes_loss_db
from analyzer_sim.scenario import NoiseFigures, Scenario
from analyzer_sim.spacecraft import Correction, attitude_history
from analyzer_sim.star_tracker import References, references
from analyzer_sim.streams import FloatArray, stream

#: longitude of the satellite, deg East
LONGITUDE_DEG = 90.0
#: the sweep for which the plan's white noise is split: RBW, duration, span
SWEEP_RBW_HZ = 30e3
SWEEP_TIME_S = 2.0
#: an interfering line stands this share of the symbol rate off the carrier's centre
INTERFERENCE_OFFSET_SHARE = 0.2
#: noise temperature of the receiving site in clear sky and of the rain, K
CLEAR_SKY_K = 120.0
RAIN_K = 270.0
_MIN_WHITE_DB = 0.05


class EndOfScenario(Exception):  # noqa: N818 - it ends a story, as StopIteration ends a loop, and is no error
    """The last row of the scenario has been swept; there is none after it."""


@dataclass(frozen=True, slots=True)
class Rows:
    """The series of a world; T rows, N carriers, NaN = absent."""

    #: (T,) microseconds
    epochs_us: EpochArray
    #: (T, N) ideal power inside each carrier's band, interference included; NaN = off or not measured, dBm
    power_dbm: FloatArray
    #: (T, N) the carrier's own power, as if it were always on, dBm
    carrier_dbm: FloatArray
    #: (T, N) power of an interfering line; NaN = none, dBm
    interference_dbm: FloatArray
    #: (T, N)
    is_on: NDArray[np.bool_]
    #: (T,) nothing is measured
    is_gap: NDArray[np.bool_]
    #: (T,) noise density at the analyzer input, dBm/Hz
    noise_dbm_hz: FloatArray
    #: (T, 3) true yaw, roll, pitch, deg
    attitude_deg: FloatArray
    #: (T, N) and (T,) rain, dB
    uplink_fade_db: FloatArray
    downlink_fade_db: FloatArray
    #: (T,) change of the receiving chain, dB
    chain_db: FloatArray
    #: (T, N) bits of FaultFlag
    flags: NDArray[np.uint8]


class World:
    """The world behind the analyzer; implements `EmissionSource`.

    Parameters
    ----------
    scenario : Scenario
        The story.
    seed : int
        Seed of every named stream, >= 0.

    Attributes
    ----------
    rows : Rows
        All series at once, for exports and tests.
    corrections, references
        What the ground was told by command and by the star tracker.
    """

    def __init__(self, scenario: Scenario, seed: int) -> None:
        self.scenario = scenario
        self.seed = seed
        self.plan: CarrierPlan = PLANS[scenario.plan]
        self.orbit = Orbit.drawn(seed, LONGITUDE_DEG, scenario.start_us)
        stop_us = scenario.phases[-1].stop_us
        epochs_us = np.arange(scenario.start_us, stop_us, scenario.row_period_us, dtype=np.int64)
        history = attitude_history(scenario, seed, epochs_us)
        self.corrections: tuple[Correction, ...] = history.corrections
        self.references: References = references(seed, epochs_us, history.attitude_deg, scenario.operation_start_us)
        self.rows: Rows = self._series(epochs_us, history.attitude_deg)
        self._measured = np.flatnonzero(~self.rows.is_gap)
        self._position = -1

    @property
    def carrier_ids(self) -> tuple[str, ...]:
        """Names of the carriers in the order of the columns."""
        return tuple(carrier.id for carrier in self.plan.carriers)

    @property
    def row_index(self) -> int:
        """Index in `rows` of the present instant."""
        return int(self._measured[max(0, self._position)])

    @property
    def next_epoch_us(self) -> int | None:
        """Epoch of the row that `advance` would return; None after the last one."""
        following = self._position + 1
        return int(self.rows.epochs_us[self._measured[following]]) if following < len(self._measured) else None

    def advance(self) -> Emission:
        """Move to the next row that is measured; the first call returns the first row.

        Raises
        ------
        EndOfScenario
            There is no further row. The present instant stays at the last one.
        """
        if self.next_epoch_us is None:
            raise EndOfScenario(f"scenario {self.scenario.name} ended after {len(self._measured)} rows")
        self._position += 1
        return self.current()

    def current(self) -> Emission:
        """Return what arrives at the present instant; before the first `advance` that is the first row."""
        return self.emission(self.row_index)

    def emission(self, row: int) -> Emission:
        """Return what arrives in a row, given by its index in `rows`."""
        rows = self.rows
        signals: list[Signal] = []
        columns = zip(self.plan.carriers, rows.carrier_dbm[row].tolist(), rows.is_on[row].tolist(), strict=True)
        for number, (carrier, power_dbm, is_on) in enumerate(columns):
            if is_on:
                signals.append(Signal(carrier.id, carrier.center_hz, carrier.symbol_rate_hz, ROLLOFF, power_dbm))
            line_dbm = float(rows.interference_dbm[row, number])
            if not np.isnan(line_dbm):
                offset_hz = INTERFERENCE_OFFSET_SHARE * carrier.symbol_rate_hz
                signals.append(Signal(f"interference {carrier.id}", carrier.center_hz + offset_hz, 0.0, 0.0, line_dbm))
        return Emission(int(rows.epochs_us[row]), tuple(signals), float(rows.noise_dbm_hz[row]))

    def _series(self, epochs_us: EpochArray, attitude_deg: FloatArray) -> Rows:
        """Add up all terms of the model equation."""
        scenario, plan = self.scenario, self.plan
        effects = effects_of(
            scenario.faults, self.seed, plan, epochs_us, scenario.operation_start_us, scenario.row_period_s / 3600.0
        )
        seconds = (epochs_us - scenario.start_us) / US_PER_S
        chain_db = effects.chain_db + _chain_db(scenario, self.seed, seconds)
        common_db = chain_db - effects.downlink_fade_db
        levels = np.array([carrier.level_dbm for carrier in plan.carriers])
        carrier_dbm = (
            levels
            + attitude_gain_db(plan, self.orbit, epochs_us, attitude_deg)
            - dishes_loss_db(plan, self.orbit, epochs_us, self.seed)
            + np.stack([_user_noise_db(carrier, scenario, self.seed, seconds) for carrier in plan.carriers], axis=1)
            + effects.level_db
            - effects.uplink_fade_db
            + common_db[:, None]
        )
        interference_dbm = effects.interference_db + levels + common_db[:, None]
        return Rows(
            epochs_us=epochs_us,
            power_dbm=_measurable_dbm(carrier_dbm, interference_dbm, effects),
            carrier_dbm=carrier_dbm,
            interference_dbm=interference_dbm,
            is_on=effects.is_on,
            is_gap=effects.is_gap,
            noise_dbm_hz=plan.noise_dbm_hz + chain_db + _rain_noise_db(effects.downlink_fade_db),
            attitude_deg=attitude_deg,
            uplink_fade_db=effects.uplink_fade_db,
            downlink_fade_db=effects.downlink_fade_db,
            chain_db=chain_db,
            flags=effects.flags,
        )


def sweep_sigma_db(plan: CarrierPlan) -> FloatArray:
    """Return the noise (N,) that the default sweep itself adds to each carrier's power, dB.

    `4.343 / sqrt(1.505 RBW T B / span)`, B = symbol rate.
    """
    span_hz = plan.span_hz[1] - plan.span_hz[0]
    rates = np.array([carrier.symbol_rate_hz for carrier in plan.carriers])
    return np.asarray(4.343 / np.sqrt(1.505 * SWEEP_RBW_HZ * SWEEP_TIME_S * rates / span_hz))


def world_white_db(plan: CarrierPlan) -> FloatArray:
    """Return the white noise (N,) that with the sweep's own share makes up the plan's figure, dB."""
    total = np.array([carrier.white_db for carrier in plan.carriers])
    return np.sqrt(np.maximum(total**2 - sweep_sigma_db(plan) ** 2, _MIN_WHITE_DB**2))


def flag_names() -> dict[str, int]:
    """Return the bits of `Rows.flags` by name."""
    return {flag.name.lower(): int(flag) for flag in FaultFlag if flag.name}


def _measurable_dbm(carrier_dbm: FloatArray, interference_dbm: FloatArray, effects: Effects) -> FloatArray:
    """Return the power inside each carrier's band, NaN where the carrier is off or nothing is measured."""
    line_mw = np.where(np.isnan(interference_dbm), 0.0, 10.0 ** (interference_dbm / 10.0))
    power_dbm = np.where(line_mw > 0.0, 10.0 * np.log10(10.0 ** (carrier_dbm / 10.0) + line_mw), carrier_dbm)
    return np.where(effects.is_on & ~effects.is_gap[:, None], power_dbm, np.nan)


def _chain_db(scenario: Scenario, seed: int, seconds: FloatArray) -> FloatArray:
    """Return the drift (T,) of the receiving chain."""
    figures: NoiseFigures = scenario.noise
    rng = stream(seed, "chain")
    wave = daily_wave(rng, seconds, figures.chain_daily_db)
    return wave + first_order(rng, len(seconds), scenario.row_period_s, figures.chain_db, figures.chain_tau_s)


def _user_noise_db(carrier: Carrier, scenario: Scenario, seed: int, seconds: FloatArray) -> FloatArray:
    """Return the noise (T,) of one user: white, coloured, day of temperature, wander."""
    figures, count, step_s = scenario.noise, len(seconds), scenario.row_period_s
    plan = PLANS[scenario.plan]
    white_db = float(world_white_db(plan)[[c.id for c in plan.carriers].index(carrier.id)]) * figures.white_scale
    white = white_db * stream(seed, "white", carrier.id).normal(size=count)
    coloured_rng = stream(seed, "coloured", carrier.id)
    sigma_db = float(coloured_rng.uniform(*figures.coloured_db))
    coloured = first_order(coloured_rng, count, step_s, sigma_db, figures.coloured_tau_s)
    thermal = daily_wave(stream(seed, "thermal", carrier.id), seconds, figures.thermal_db)
    wander_db = carrier.wander_db * figures.wander_scale
    wander = first_order(stream(seed, "wander", carrier.id), count, step_s, wander_db, figures.wander_tau_s)
    return np.asarray(white + coloured + thermal + wander)


def _rain_noise_db(fade_db: FloatArray) -> FloatArray:
    """Return how much the rain over the receiving site raises the noise, dB."""
    rain_k = RAIN_K * (1.0 - 10.0 ** (-fade_db / 10.0))
    return np.asarray(10.0 * np.log10((CLEAR_SKY_K + rain_k) / CLEAR_SKY_K))
