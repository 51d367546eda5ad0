"""A method of estimation as the chain sees it, its evidence and its results of each carrier."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from service.core.estimation.filtering.filter_model import CarrierModel
from service.pipeline.inputs.knowledge import Knowledge
from service.records.catalogue import Carrier, CarrierPlan, Method
from service.records.inputs import Operation, SlowInput
from service.records.levels.attitude import (
    CARRIER_STATES,
    AttitudeRow,
    BoolArray,
    CarrierResults,
    CarrierState,
    Disturbance,
    FloatArray,
    IntArray,
)
from service.records.levels.measurement import Measurement


class CarrierLevels(NamedTuple):
    """Levels of the carriers in a method's newest row, as arrays (N,)."""

    carrier_ids: tuple[str, ...]
    #: dB, measured minus expected; NaN = absent
    deviation_db: FloatArray
    #: dB, part that neither the attitude nor what all carriers have in common explains
    residual_db: FloatArray
    #: dB, noise of one row
    sigma_db: FloatArray
    #: whether the calibration uses it
    is_used: BoolArray
    #: positions in `CARRIER_HYPOTHESES`
    hypothesis: IntArray


class CommandEvidence(NamedTuple):
    """Evidence of a row on the execution of commands."""

    #: geometry and noise of the N carriers
    model: CarrierModel
    #: (N,) dB, measured minus expected; NaN = absent or not used
    deviation_db: FloatArray
    #: logarithm of the likelihood of "no effect" or "reversed" over that of the commands as reported
    missed_log_ratio: float
    #: the same of the unreported command; None: there is none
    unreported_log_ratio: float | None


def nothing_known() -> None:
    """Return what a method knows that knows nothing."""


class MethodRow(NamedTuple):
    """Row of a method in time, with what else it made of the powers."""

    row: AttitudeRow
    #: figures of the carriers, None where nothing was computed; they are not copied
    levels: CarrierLevels | None = None
    #: returns the torque that acts without being fed forward, None where the method knows of none
    disturbance: Callable[[], Disturbance | None] = nothing_known
    #: returns the evidence on commands, None where the method has none
    command_evidence: Callable[[], CommandEvidence | None] = nothing_known


class MethodRunner(Protocol):
    """One method with its model and its state."""

    @property
    def method(self) -> Method:
        """Which method this is."""

    @property
    def is_running(self) -> bool:
        """Return whether rows lead to angles."""

    def on_input(self, content: SlowInput, knowledge: Knowledge) -> None:
        """Take in a slow input that concerns the motion of the spacecraft."""

    def start(self, knowledge: Knowledge) -> None:
        """Begin at the alignment that holds."""

    def rebuild(self, knowledge: Knowledge) -> None:
        """Take over a change of calibration, ephemeris or spacecraft; the state is kept."""

    def steps(
        self,
        measurements: Sequence[Measurement],
        plan: CarrierPlan,
        knowledge: Knowledge,
        *,
        is_late: bool,
        is_catch_up: bool,
    ) -> list[MethodRow]:
        """Return the rows of measurements in order; the state moves on unless they are late.

        Where it raises an error the state is as before the first of them.
        """

    @property
    def is_waiting(self) -> bool:
        """Return whether the state is not all on which the next row depends, so that it cannot be saved now."""

    def saved(self) -> Any:
        """Return the method's own record of its state, from which `restore` goes on; None while nothing runs."""

    def restore(self, saved: Any, knowledge: Knowledge) -> None:
        """Go on from a saved state under the knowledge of then."""

    def carrier_states(self) -> dict[str, CarrierState]:
        """Return the state of each carrier of the calibration after the newest row."""


class CarrierColumns(NamedTuple):
    """Positions of carriers among others, -1 for those that are not among them."""

    positions: IntArray
    #: the carriers are the first of the others, in their order
    is_first: bool

    @classmethod
    def among(cls, carrier_ids: Sequence[str], position_of: Mapping[str, int]) -> "CarrierColumns":
        """Return the positions of some carriers."""
        positions = np.array([position_of.get(name, -1) for name in carrier_ids], dtype=np.int64)
        is_first = bool((positions == np.arange(len(positions))).all())
        return cls(positions, is_first)

    def of(self, values: NDArray[Any], absent: float) -> NDArray[Any]:
        """Return the values (..., N) of the carriers, `absent` for those that are not among the others."""
        if self.is_first:
            return values[..., : len(self.positions)]
        return np.where(self.positions < 0, absent, values[..., self.positions])


class CalibratedColumns:
    """Brings the powers of a row into the order of a calibration's carriers.

    Carriers are matched by id; one that is another signal than the calibrated one (moved to another station,
    transponder or frequency) counts as absent.

    Parameters
    ----------
    carrier_ids : tuple of str
        Carriers of the calibration.
    calibrated : CarrierPlan
        Plan that the calibration was made with.
    """

    def __init__(self, carrier_ids: tuple[str, ...], calibrated: CarrierPlan) -> None:
        self._carrier_ids = carrier_ids
        self._calibrated = {carrier.id: carrier for carrier in calibrated.carriers}
        self._columns: dict[int, CarrierColumns] = {}

    def power_dbm(self, measurement: Measurement, plan: CarrierPlan) -> FloatArray:
        """Return the powers (N,) in dBm, NaN where the plan has no such carrier."""
        return self._of(plan).of(measurement.power_dbm, np.nan)

    def fit_power_dbm(self, measurement: Measurement, plan: CarrierPlan, unfit: int) -> FloatArray:
        """Return the same, NaN also where one of the quality flags `unfit` stands."""
        power_dbm = self.power_dbm(measurement, plan)
        if measurement.flags is None:
            return power_dbm
        return np.where(self._of(plan).of(measurement.flags, 0) & unfit, np.nan, power_dbm)

    def _of(self, plan: CarrierPlan) -> CarrierColumns:
        if plan.id not in self._columns:
            position = {
                carrier.id: k
                for k, carrier in enumerate(plan.carriers)
                if _is_same_signal(carrier, self._calibrated.get(carrier.id))
            }
            self._columns[plan.id] = CarrierColumns.among(self._carrier_ids, position)
        return self._columns[plan.id]


def _is_same_signal(carrier: Carrier, calibrated: Carrier | None) -> bool:
    """Return whether two entries of plans are one signal of one station through one transponder."""
    return calibrated is not None and (
        (carrier.station, carrier.transponder, carrier.band, carrier.uplink_hz, carrier.downlink_hz)
        == (
            calibrated.station,
            calibrated.transponder,
            calibrated.band,
            calibrated.uplink_hz,
            calibrated.downlink_hz,
        )
    )


_USED, _ABSENT, _EXCLUDED, _UNSELECTED, _UNCALIBRATED = range(len(CARRIER_STATES))


def carrier_results(
    rows: Sequence[MethodRow], measurements: Sequence[Measurement], plan: CarrierPlan
) -> list[CarrierResults | None]:
    """Return what a method makes of the carriers at rows in time of one plan; None where it failed."""
    results: list[CarrierResults | None] = [None] * len(rows)
    levels = {number: row.levels for number, row in enumerate(rows) if row.levels is not None}
    if not levels:
        return results
    calibrated = next(iter(levels.values())).carrier_ids
    columns = _columns(plan.carrier_ids, calibrated)
    states = np.where(_together([each.is_used for each in levels.values()]), _USED, _UNSELECTED)
    for place, number in enumerate(levels):
        for exclusion in rows[number].row.excluded:
            # the levels need not know it
            if exclusion.carrier in calibrated:
                states[place, calibrated.index(exclusion.carrier)] = _EXCLUDED
    state = columns.of(states, _UNCALIBRATED)
    state[np.isnan(_together([measurements[number].power_dbm for number in levels]))] = _ABSENT
    deviation_db = columns.of(_together([each.deviation_db for each in levels.values()]), np.nan)
    residual_db = columns.of(_together([each.residual_db for each in levels.values()]), np.nan)
    hypothesis = columns.of(_together([each.hypothesis for each in levels.values()]), 0)
    figures = zip(deviation_db, residual_db, state, hypothesis, strict=True)
    for number, each in zip(levels, figures, strict=True):
        results[number] = CarrierResults(plan.id, *each)
    return results


def _together(rows: list[NDArray[Any]]) -> NDArray[Any]:
    """Return rows (N,) as an array (T, N); a single one, as it comes live, is not copied."""
    return np.array(rows) if len(rows) > 1 else rows[0][np.newaxis]


@lru_cache(maxsize=256)
def _columns(carrier_ids: tuple[str, ...], calibrated: tuple[str, ...]) -> CarrierColumns:
    """Return the positions of a plan's carriers among the calibrated ones."""
    return CarrierColumns.among(carrier_ids, {name: k for k, name in enumerate(calibrated)})


def carrier_state(measurement: Measurement, k: int, name: str, known: dict[str, CarrierState]) -> CarrierState:
    """Return the state of the k-th carrier of a row."""
    power_dbm = float(measurement.power_dbm[k])
    flags = 0 if measurement.flags is None else int(measurement.flags[k])
    state = known.get(name) or CarrierState(name, *(math.nan,) * 5, 0, "uncalibrated")
    word = "absent" if np.isnan(power_dbm) else state.state
    return replace(state, power_dbm=power_dbm, flags=flags, state=word)


class RowEvidence(NamedTuple):
    """One row as the chain leaves it: neither late nor caught up with."""

    measurement: Measurement
    plan: CarrierPlan
    #: what the methods say; empty while none runs
    rows: tuple[AttitudeRow, ...]
    #: the one that drives control
    method: Method
    levels: CarrierLevels | None
    #: newest revision of each declared operation
    operations: Mapping[int, Operation]
    #: by how much the methods differ while they disagree, 0 while they agree; NaN: not compared
    disagreement_deg: float = math.nan
