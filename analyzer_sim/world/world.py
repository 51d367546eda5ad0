"""World: a scenario and a seed become series of powers at the analyzer input, row by row (`level_terms.py`).

Everything is computed at construction; `advance` only moves a pointer. Rows inside a gap are passed over. A row is
measured at its epoch, the middle of its dwell. After the last row `advance` raises `EndOfScenario`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analyzer_sim.emission import Emission, EndOfScenario, Signal
from analyzer_sim.streams import FloatArray
from analyzer_sim.world.ballistics import Ephemeris, burn_operations, burnt_orbit, ephemerides, unloading_operations
from analyzer_sim.world.faults import effects_of
from analyzer_sim.world.orbit import EpochArray, Orbit
from analyzer_sim.world.payload.carriers import PLANS, ROLLOFF, CarrierPlan, PlanVersion, plan_versions
from analyzer_sim.world.payload.effects import Effects, FaultFlag, Operation
from analyzer_sim.world.payload.level_terms import LevelTerms, sensitivity_db_per_deg
from analyzer_sim.world.polarimeter import PolarizationReport, polarization_reports
from analyzer_sim.world.scenario.story import Scenario
from analyzer_sim.world.sensors import References, references
from analyzer_sim.world.spacecraft.body import INERTIA_KG_M2
from analyzer_sim.world.spacecraft.spacecraft import Correction, Sensing, attitude_history, sensed_error_deg
from analyzer_sim.world.spacecraft.telemetry import TelemetryRecord, telemetry

#: longitude of the satellite, deg East
LONGITUDE_DEG = 90.0
#: an interfering line stands this share of the symbol rate off the carrier's centre
INTERFERENCE_OFFSET_SHARE = 0.2
#: level and power control count as acting from here on, dB
_CONTROL_DB = 0.1


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
    #: (T, N) changes of level by faults, by power control and by level control, dB
    level_db: FloatArray
    #: (T,) rise of the noise density by the Sun, dB
    sun_noise_db: FloatArray
    #: (T, 2) shift of the uplink patterns against the body, azimuth and elevation, deg
    pattern_shift_deg: FloatArray
    #: (T,) number of the analyzer in `SOURCES`
    source: NDArray[np.uint8]
    #: (T, N) bits of FaultFlag
    flags: NDArray[np.uint16]


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
        What the ground was told about commands, and by the sensors.
    witnesses
        What the sensors would have told in operation, for the judge.
    operations, ephemerides, plan_versions, telemetry, polarization, source_switches
        What the ground declares, publishes and hears, each with the epoch from which it knows.
    terms : LevelTerms
        The levels without the attitude.
    """

    def __init__(self, scenario: Scenario, seed: int) -> None:
        self.scenario = scenario
        self.seed = seed
        self.plan: CarrierPlan = PLANS[scenario.plan]
        self.orbit = burnt_orbit(scenario, seed, Orbit.drawn(seed, LONGITUDE_DEG, scenario.start_us))
        epochs_us = row_epochs_us(scenario)
        effects = effects_of(
            scenario.faults,
            seed,
            self.plan,
            epochs_us,
            scenario.operation_start_us,
            scenario.row_period_s / 3600.0,
        )
        self.terms = LevelTerms(scenario, seed, self.plan, self.orbit, epochs_us, effects)
        history = attitude_history(scenario, seed, epochs_us, self._sensing(epochs_us))
        self.corrections: tuple[Correction, ...] = history.corrections
        reported = references(scenario.sensors, seed, epochs_us, history.attitude_deg)
        is_before = reported.epochs_us < scenario.operation_start_us
        self.references: References = reported.of(is_before)
        self.witnesses: References = reported.of(~is_before)
        self.rows: Rows = self._series(epochs_us, history.attitude_deg, effects)
        burns = burn_operations(scenario.burns, self.orbit)
        declared = [*burns, *unloading_operations(scenario), *effects.operations]
        self.operations: tuple[Operation, ...] = tuple(
            sorted(declared, key=lambda item: (item.reported_us, item.start_us))
        )
        self.ephemerides: tuple[Ephemeris, ...] = ephemerides(scenario, self.orbit)
        self.plan_versions: tuple[PlanVersion, ...] = plan_versions(scenario, self.plan)
        self.source_switches: tuple[tuple[int, str], ...] = tuple(sorted(effects.source_switches))
        burns_us = tuple(impulse.epoch_us for impulse in self.orbit.impulses)
        self.telemetry: tuple[TelemetryRecord, ...] = telemetry(
            scenario, seed, burns_us, INERTIA_KG_M2, epochs_us, history.attitude_deg
        )
        self.polarization: tuple[PolarizationReport, ...] = polarization_reports(
            scenario,
            seed,
            self.orbit,
            self.plan.receiving_site,
            epochs_us,
            history.attitude_deg,
            effects.downlink_fade_db,
        )
        self._measured = np.flatnonzero(~self.rows.is_gap)
        self._position = -1

    def _sensing(self, epochs_us: EpochArray) -> Sensing | None:
        """Return what an operator who commands from the powers makes of their noise, None where nobody does."""
        if not self.scenario.keeping.is_steered_by_powers:
            return None
        alignment = self.scenario.phase("alignment")
        is_aligned = (epochs_us >= alignment.start_us) & (epochs_us < alignment.stop_us)
        slopes = sensitivity_db_per_deg(self.plan, self.orbit)
        return Sensing(*sensed_error_deg(slopes, self.terms.noise_db, is_aligned))

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

    def emission(self, row: int, carrier_dbm: FloatArray | None = None) -> Emission:
        """Return what arrives in a row, given by its index in `rows`; its carriers (N,) may be given, dBm."""
        rows = self.rows
        powers_dbm = rows.carrier_dbm[row] if carrier_dbm is None else carrier_dbm
        signals: list[Signal] = []
        columns = zip(self.plan.carriers, powers_dbm.tolist(), rows.is_on[row].tolist(), strict=True)
        for number, (carrier, power_dbm, is_on) in enumerate(columns):
            if is_on:
                signals.append(Signal(carrier.id, carrier.center_hz, carrier.symbol_rate_hz, ROLLOFF, power_dbm))
            line_dbm = float(rows.interference_dbm[row, number])
            if not np.isnan(line_dbm):
                offset_hz = INTERFERENCE_OFFSET_SHARE * carrier.symbol_rate_hz
                signals.append(Signal(f"interference {carrier.id}", carrier.center_hz + offset_hz, 0.0, 0.0, line_dbm))
        return Emission(int(rows.epochs_us[row]), tuple(signals), float(rows.noise_dbm_hz[row]))

    def _series(self, epochs_us: EpochArray, attitude_deg: FloatArray, effects: Effects) -> Rows:
        """Add up all terms of the model equation."""
        terms, levels = self.terms, self.terms.levels(attitude_deg)
        if terms.has_control:
            controls = (
                (levels.power_control_db, FaultFlag.POWER_CONTROL),
                (levels.level_control_db, FaultFlag.LEVEL_CONTROL),
            )
            for change_db, flag in controls:
                effects.flags[np.abs(change_db) > _CONTROL_DB] |= np.uint16(flag)
        return Rows(
            epochs_us=epochs_us,
            power_dbm=terms.measurable_dbm(levels.carrier_dbm),
            carrier_dbm=levels.carrier_dbm,
            interference_dbm=terms.interference_dbm,
            is_on=effects.is_on,
            is_gap=effects.is_gap,
            noise_dbm_hz=terms.noise_dbm_hz,
            attitude_deg=attitude_deg,
            uplink_fade_db=effects.uplink_fade_db,
            downlink_fade_db=effects.downlink_fade_db,
            chain_db=terms.chain_db,
            level_db=effects.level_db + levels.power_control_db + levels.level_control_db,
            sun_noise_db=effects.sun_noise_db,
            pattern_shift_deg=effects.pattern_shift_deg,
            source=effects.source,
            flags=effects.flags,
        )


def row_epochs_us(scenario: Scenario) -> EpochArray:
    """Return the epochs (T,) of all rows; a pause has none."""
    starts_us = [scenario.start_us, *(p.stop_us for p in scenario.phases if p.name == "pause")]
    stops_us = [*(p.start_us for p in scenario.phases if p.name == "pause"), scenario.stop_us]
    spans = zip(starts_us, stops_us, strict=True)
    return np.concatenate([np.arange(start, stop, scenario.row_period_us, dtype=np.int64) for start, stop in spans])


def flag_names() -> dict[str, int]:
    """Return the bits of `Rows.flags` by name."""
    return {flag.name.lower(): int(flag) for flag in FaultFlag if flag.name}
