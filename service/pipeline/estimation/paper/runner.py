"""The paper method from L1 to L4, and in the chain: its state, its rows, and what is known of each carrier.

The published equations, with their state made explicit. Order: harmonic removal, downlink fade rule, trailing mean,
fix over the eight octants, rate, interlock verdict. The state is a value: rows take one and return the next, so that a
replay can start from any of them.
"""

import math
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.compiled_entry import CompiledEntry
from service.core.estimation.filtering import filter_model, plant
from service.core.estimation.filtering import motion as body_motion
from service.core.estimation.paper import downlink_fade, harmonic, loop_observer, snapshot
from service.core.estimation.paper import row as paper_row
from service.core.estimation.paper.loop_observer import initial_estimate, with_other_torque
from service.core.estimation.paper.row import (
    LEVEL,
    RESULT,
    PaperBlock,
    PaperState,
    empty_means,
    initial_arrays,
    room,
    without_room,
)
from service.core.estimation.paper.snapshot import ABSENT, USED
from service.core.geometry.line_of_sight import node_phase_at_rad
from service.pipeline.config import ChainConfig
from service.pipeline.estimation.method import CalibratedColumns, CarrierLevels, MethodRow
from service.pipeline.estimation.paper.paper_model import PaperModel, paper_model
from service.pipeline.estimation.row_inhibitions import judge
from service.pipeline.inputs.knowledge import Knowledge, Lookup
from service.pipeline.inputs.known_motion import (
    CommandedMotion,
    commanded_arrays,
    disturbance_of,
    heard,
    without_past,
)
from service.records.calibration import Alignment
from service.records.catalogue import CarrierPlan, Method
from service.records.inputs import Correction, SlowInput
from service.records.levels.attitude import (
    NO_ANGLES,
    AppliedCommand,
    AttitudeRow,
    Axes,
    CarrierState,
    Disturbance,
    Exclusion,
    FloatArray,
    IntArray,
    ReportedCommand,
    Status,
)
from service.records.levels.measurement import Measurement

#: sigma of an alignment's angle that nobody states, deg
_ALIGNMENT_DEG = 0.1
TAKE_ROWS = CompiledEntry(
    paper_row.take_rows, (filter_model, plant, body_motion, harmonic, downlink_fade, snapshot, loop_observer, paper_row)
)


class LoopState(NamedTuple):
    """State of the paper method between two rows, and what was commanded since its estimate."""

    arrays: PaperState
    commanded: CommandedMotion


class PaperStep(NamedTuple):
    """One row's outcome."""

    row: AttitudeRow
    #: (N,) of `LEVEL`
    levels: NDArray[np.void]
    #: record of `RESULT`
    result: np.void


def initial_state(alignment: Alignment, model: PaperModel) -> LoopState:
    """Return the state at an alignment."""
    attitude = np.nan_to_num(np.array(alignment.attitude_deg))
    sigma = np.nan_to_num(np.array(alignment.sigma_deg), nan=_ALIGNMENT_DEG)
    estimate = initial_estimate(attitude, sigma, model.motion)
    arrays = initial_arrays(len(model.carrier_ids), alignment.epoch_us, *estimate)
    return LoopState(arrays, CommandedMotion(alignment.epoch_us))


def take_rows(
    state: LoopState,
    model: PaperModel,
    knowledge: Knowledge,
    measurements: Sequence[Measurement],
    power_dbm: FloatArray,
    *,
    is_late: bool,
    is_catch_up: bool,
    config: ChainConfig,
) -> tuple[list[PaperStep], LoopState]:
    """Take rows whose powers (T, N) stand in the calibration's order; return their outcomes and the next state.

    Late rows get fixes of their own and leave the state alone.
    """
    count, carriers = power_dbm.shape
    levels, results = np.empty((count, carriers), LEVEL), np.zeros(count, RESULT)
    after = state.arrays if is_late else room(state.arrays, count)
    block = PaperBlock(*_times(measurements, knowledge), power_dbm, is_late)
    commanded = commanded_arrays(state.commanded, int(block.epochs_us.max()))
    TAKE_ROWS(model.arrays, state.arrays, after, commanded, block, levels, results)
    by_name = (results[name].tolist() for name in _Figures._fields)
    rows = []
    for number, (measurement, figures) in enumerate(
        zip(measurements, map(_Figures._make, zip(*by_name, strict=True)), strict=True)
    ):
        conditions = {
            "late": is_late,
            "catch_up": is_catch_up,
            "settling": not is_late and figures.rows < config.estimation.min_rows,
            "downlink_fade": figures.is_fading,
            "common_change": figures.is_risen,
            "operation": bool(knowledge.inhibiting_operations(measurement.epoch_us)),
            "undeclared_operation": knowledge.is_thrusting_undeclared(measurement.epoch_us),
        }
        inhibitions = judge(figures.attitude_deg, figures.carriers_used, conditions, config.interlock)
        rows.append(_row(measurement, model, figures, levels[number], inhibitions, is_late=is_late))
    moved = state if is_late else _moved(state, after)
    return list(map(PaperStep, rows, levels, results)), moved


class _Figures(NamedTuple):
    """Figures of a row, named as in `RESULT`; triples in the order yaw, roll, pitch."""

    attitude_deg: list[float]
    sigma_deg: list[float]
    steering_deg: list[float]
    steering_sigma_deg: list[float]
    rates_deg_s: list[float]
    carriers_used: int
    carriers_out: int
    residual_rms_db: float
    rows: int
    is_fading: bool
    is_risen: bool
    fade_db: float


def _times(measurements: Sequence[Measurement], knowledge: Knowledge) -> tuple[IntArray, FloatArray]:
    """Return the epochs (T,) of rows, and their phases since the ascending node, rad."""
    if knowledge.ephemeris is None:
        message = "the paper method was stepped without an ephemeris"
        raise ValueError(message)
    nodes_us, period_s = knowledge.ephemeris.ascending_nodes_us, knowledge.ephemeris.nodal_period_s
    phases_rad = np.array([node_phase_at_rad(each.epoch_us, nodes_us, period_s) for each in measurements])
    return np.array([each.epoch_us for each in measurements], dtype=np.int64), phases_rad


def _moved(before: LoopState, after: PaperState) -> LoopState:
    """Return the state after rows, freed from room and from motion that the estimate has consumed."""
    newest_us = int(after.counters["estimate_us"][0])
    is_moved = newest_us > before.arrays.counters["estimate_us"][0]
    return LoopState(without_room(after), without_past(before.commanded, newest_us) if is_moved else before.commanded)


def _row(
    measurement: Measurement,
    model: PaperModel,
    figures: _Figures,
    levels: NDArray[np.void],
    inhibitions: tuple[str, ...],
    *,
    is_late: bool,
) -> AttitudeRow:
    """Return the archive's row of one outcome."""
    angles = Axes(*figures.attitude_deg)
    # what all levels have in common went into the angles
    has_angles = all(map(math.isfinite, angles)) and "common_change" not in inhibitions
    return AttitudeRow(
        epoch_us=measurement.epoch_us,
        received_at_us=measurement.received_at_us,
        number=measurement.number,
        method=Method.PAPER,
        attitude_deg=angles,
        sigma_deg=Axes(*figures.sigma_deg),
        rates_deg_s=None if is_late else Axes(*figures.rates_deg_s),
        status=Status.ACQUIRED if has_angles else Status.INVALID,
        control_allowed=not inhibitions,
        # yaw follows from roll and from what was commanded, whatever the fix says of it
        control_allowed_axes=(not inhibitions,) * 3,
        inhibitions=inhibitions,
        carriers_used=figures.carriers_used,
        excluded=_exclusions(model, levels) if figures.carriers_out else (),
        downlink_fade="downlink_fade" in inhibitions,
        downlink_fade_db=figures.fade_db,
        common_db=float("nan"),
        residual_rms_db=figures.residual_rms_db,
        calibration_id=model.calibration_id,
        alignment_id=model.alignment_id,
        steering_deg=NO_ANGLES if is_late else Axes(*figures.steering_deg),
        steering_sigma_deg=NO_ANGLES if is_late else Axes(*figures.steering_sigma_deg),
    )


def _exclusions(model: PaperModel, levels: NDArray[np.void]) -> tuple[Exclusion, ...]:
    """Return the selected carriers that did not enter, each with its reason."""
    reason, is_selected = levels["reason"], model.arrays.carriers["is_selected"]
    return tuple(
        Exclusion(model.carrier_ids[k], "absent" if reason[k] == ABSENT else "uplink_fade")
        for k in np.flatnonzero(is_selected & (reason != USED)).tolist()
    )


class SavedPaper(NamedTuple):
    """State of the method between two rows, its newest row, and what that left of each carrier."""

    state: LoopState
    row: AttitudeRow | None
    levels: NDArray[np.void] | None


class PaperRunner:
    """Runs the paper method; `MethodRunner`."""

    method = Method.PAPER

    def __init__(self, lookup: Lookup, config: ChainConfig) -> None:
        self._lookup = lookup
        self._config = config
        self._model: PaperModel | None = None
        self._state: LoopState | None = None
        self._columns: CalibratedColumns | None = None
        #: newest row in time, what it left of each carrier, and its model
        self._last: tuple[AttitudeRow, NDArray[np.void], PaperModel] | None = None

    @property
    def is_running(self) -> bool:
        """Return whether rows lead to angles."""
        return self._model is not None

    def on_input(self, content: SlowInput, knowledge: Knowledge) -> None:
        """Take in what moves the spacecraft."""
        if isinstance(content, Correction | AppliedCommand | ReportedCommand) and self._state is not None:
            newest_us = int(self._state.arrays.counters["estimate_us"][0])
            commanded = heard(self._state.commanded, content, knowledge.spacecraft, newest_us)
            self._state = self._state._replace(commanded=commanded)

    def start(self, knowledge: Knowledge) -> None:
        """Begin at the alignment that holds."""
        self._model, self._columns = self._model_of(knowledge)
        self._state = None
        if self._model is not None and knowledge.alignment is not None:
            self._state = initial_state(knowledge.alignment, self._model)
        self._last = None

    def rebuild(self, knowledge: Knowledge) -> None:
        """Take over a change; another set of carriers starts the means again."""
        former = self._model
        self._model, self._columns = self._model_of(knowledge)
        if self._model is None:
            return
        if former is None or self._state is None:
            self.start(knowledge)
            return
        arrays = self._state.arrays
        if former.motion != self._model.motion:
            mean, covariance = with_other_torque(arrays.mean, arrays.covariance, self._model.motion)
            arrays = arrays._replace(mean=mean, covariance=covariance)
        if former.carrier_ids != self._model.carrier_ids:
            arrays = empty_means(arrays, len(self._model.carrier_ids))
        self._state = self._state._replace(arrays=arrays)

    def steps(
        self,
        measurements: Sequence[Measurement],
        plan: CarrierPlan,
        knowledge: Knowledge,
        *,
        is_late: bool,
        is_catch_up: bool,
    ) -> list[MethodRow]:
        """Return the rows of measurements in order; the state moves on unless they are late."""
        model, columns = self._model, self._columns
        if model is None or self._state is None or columns is None:
            message = "the paper method was stepped without a model"
            raise ValueError(message)
        power_dbm = np.array([columns.power_dbm(each, plan) for each in measurements])
        found, self._state = take_rows(
            self._state,
            model,
            knowledge,
            measurements,
            power_dbm,
            is_late=is_late,
            is_catch_up=is_catch_up,
            config=self._config,
        )
        if is_late:
            return [MethodRow(each.row) for each in found]
        self._last = found[-1].row, found[-1].levels, model
        return [
            MethodRow(each.row, _carrier_levels(each.levels, model), partial(_disturbance, each.result, model))
            for each in found
        ]

    @property
    def is_waiting(self) -> bool:
        """Return False: no row is ever taken again."""
        return False

    def saved(self) -> SavedPaper | None:
        """Return what `restore` goes on from; None while nothing runs."""
        if self._state is None:
            return None
        if self._last is None or self._last[2] is not self._model:
            return SavedPaper(self._state, None, None)
        row, levels, _ = self._last
        return SavedPaper(self._state, row, levels)

    def restore(self, saved: SavedPaper, knowledge: Knowledge) -> None:
        """Go on from a saved state under the knowledge of then."""
        self._model, self._columns = self._model_of(knowledge)
        self._state = saved.state
        if saved.row is not None and saved.levels is not None and self._model is not None:
            self._last = saved.row, saved.levels, self._model

    def carrier_states(self) -> dict[str, CarrierState]:
        """Return the state of each carrier of the calibration after the newest row."""
        if self._last is None:
            return {}
        row, levels, model = self._last
        is_selected, excluded = model.arrays.carriers["is_selected"], {item.carrier for item in row.excluded}
        return {
            name: CarrierState(
                carrier=name,
                power_dbm=float("nan"),
                expected_dbm=float(levels["expected_dbm"][k]),
                deviation_db=float(levels["deviation_db"][k]),
                residual_db=float(levels["residual_db"][k]),
                sigma_db=float(levels["sigma_db"][k]),
                flags=0,
                state="unselected" if not is_selected[k] else ("excluded" if name in excluded else "used"),
            )
            for k, name in enumerate(model.carrier_ids)
        }

    def _model_of(self, knowledge: Knowledge) -> tuple[PaperModel | None, CalibratedColumns | None]:
        """Return the model that holds and the order of its carriers."""
        alignment, calibration = knowledge.alignment, knowledge.calibration_for(Method.PAPER)
        if alignment is None or calibration is None:
            return None, None
        aligned_id = alignment.calibration_by_method.get(Method.PAPER.value, alignment.calibration_id)
        plan = self._lookup.plan(calibration.plan_id)
        model = paper_model(knowledge, plan, self._lookup.calibration(aligned_id), self._config)
        if model is None:
            return None, None
        return model, CalibratedColumns(model.carrier_ids, plan)


def _carrier_levels(levels: NDArray[np.void], model: PaperModel) -> CarrierLevels:
    """Return the figures of the carriers in a row; they are not copied."""
    figures = levels["deviation_db"], levels["residual_db"], levels["sigma_db"]
    no_hypothesis = np.zeros(len(levels), dtype=np.int64)
    return CarrierLevels(model.carrier_ids, *figures, model.arrays.carriers["is_selected"], no_hypothesis)


def _disturbance(result: np.void, model: PaperModel) -> Disturbance | None:
    """Return the torque that the loop has learned by a row; None where it knows of none."""
    if model.inertia_kg_m2 is None:
        return None
    return disturbance_of(result["torque_deg_h2"], model.motion, model.inertia_kg_m2, int(result["estimate_us"]))
