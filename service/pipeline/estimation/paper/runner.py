"""The paper method in the chain: its model, its state, and what is known of each carrier."""

from typing import NamedTuple

import numpy as np

from service.pipeline.config import ChainConfig
from service.pipeline.estimation.method import CalibratedColumns, CarrierLevels, CommandEvidence
from service.pipeline.estimation.paper.loop_state import (
    initial_loop,
    loop_disturbance,
    loop_with_input,
    loop_with_torque,
)
from service.pipeline.estimation.paper.method import (
    PaperModel,
    PaperState,
    PaperStep,
    initial_state,
    paper_model,
    step_paper,
)
from service.pipeline.inputs.knowledge import Knowledge, Lookup
from service.records.catalogue import CarrierPlan, Method
from service.records.inputs import Correction, SlowInput
from service.records.levels.attitude import (
    AppliedCommand,
    AttitudeFix,
    AttitudeRow,
    CarrierState,
    Deviation,
    Disturbance,
    ReportedCommand,
)
from service.records.levels.measurement import Measurement


class SavedPaper(NamedTuple):
    """State of the method between two rows, and its newest row."""

    state: PaperState
    row: AttitudeRow | None
    deviation: Deviation | None
    fix: AttitudeFix | None


class PaperRunner:
    """Runs the paper method; `MethodRunner`."""

    method = Method.PAPER

    def __init__(self, lookup: Lookup, config: ChainConfig) -> None:
        self._lookup = lookup
        self._config = config
        self._model: PaperModel | None = None
        self._state: PaperState | None = None
        self._columns: CalibratedColumns | None = None
        self._last: tuple[PaperStep, PaperModel] | None = None

    @property
    def is_running(self) -> bool:
        """Return whether rows lead to angles."""
        return self._model is not None

    def on_input(self, content: SlowInput, knowledge: Knowledge) -> None:
        """Take in what moves the spacecraft."""
        if isinstance(content, Correction | AppliedCommand | ReportedCommand) and self._state is not None:
            loop = loop_with_input(self._state.loop, content, knowledge.spacecraft)
            self._state = self._state._replace(loop=loop)

    def start(self, knowledge: Knowledge) -> None:
        """Begin at the alignment that holds."""
        self._model, self._columns = self._model_of(knowledge)
        self._state = None
        if self._model is not None and knowledge.alignment is not None:
            loop = initial_loop(knowledge.alignment, self._model.loop)
            self._state = initial_state(len(self._model.expected.carrier_ids), self._config, loop)
        self._last = None

    def rebuild(self, knowledge: Knowledge) -> None:
        """Take over a change; another set of carriers starts the means again."""
        former = self._model
        self._model, self._columns = self._model_of(knowledge)
        if self._model is None:
            return
        carrier_ids = self._model.expected.carrier_ids
        if former is None or self._state is None:
            self.start(knowledge)
            return
        if former.loop.motion != self._model.loop.motion:
            self._state = self._state._replace(loop=loop_with_torque(self._state.loop, self._model.loop))
        if former.expected.carrier_ids != carrier_ids:
            self._state = initial_state(len(carrier_ids), self._config, self._state.loop)

    def step(
        self, measurement: Measurement, plan: CarrierPlan, knowledge: Knowledge, *, is_late: bool, is_catch_up: bool
    ) -> AttitudeRow:
        """Return the row of a measurement; the state moves on unless the row is late."""
        if self._model is None or self._state is None or self._columns is None or knowledge.ephemeris is None:
            message = "the paper method was stepped without a model"
            raise ValueError(message)
        outcome = step_paper(
            self._state,
            self._model,
            knowledge,
            knowledge.ephemeris,
            measurement,
            self._columns.power_dbm(measurement, plan),
            is_late=is_late,
            is_catch_up=is_catch_up,
            config=self._config,
        )
        self._state = outcome.state
        if not is_late:
            self._last = (outcome, self._model)
        return outcome.row

    @property
    def is_waiting(self) -> bool:
        """Return False: no row is ever taken again."""
        return False

    def saved(self) -> SavedPaper | None:
        """Return what `restore` goes on from; None while nothing runs."""
        if self._state is None:
            return None
        if self._last is None or self._last[1] is not self._model:
            return SavedPaper(self._state, None, None, None)
        last, _ = self._last
        return SavedPaper(self._state, last.row, last.deviation, last.fix)

    def restore(self, saved: SavedPaper, knowledge: Knowledge) -> None:
        """Go on from a saved state under the knowledge of then."""
        self._model, self._columns = self._model_of(knowledge)
        self._state = saved.state
        if saved.row is not None and saved.deviation is not None and saved.fix is not None and self._model is not None:
            self._last = PaperStep(saved.row, saved.deviation, saved.fix, saved.state), self._model

    def carrier_states(self) -> dict[str, CarrierState]:
        """Return the state of each carrier of the calibration after the newest row."""
        if self._last is None:
            return {}
        outcome, model = self._last
        sensitivity = model.sensitivity
        excluded = {item.carrier for item in outcome.fix.excluded}
        return {
            name: CarrierState(
                carrier=name,
                power_dbm=float("nan"),
                expected_dbm=float(outcome.deviation.expected_dbm[k]),
                deviation_db=float(outcome.deviation.deviation_db[k]),
                residual_db=float(outcome.fix.residual_db[k]),
                sigma_db=float(outcome.fix.sigma_db[k]),
                flags=0,
                state="unselected" if not sensitivity.is_selected[k] else ("excluded" if name in excluded else "used"),
            )
            for k, name in enumerate(sensitivity.carrier_ids)
        }

    def carrier_levels(self) -> CarrierLevels | None:
        """Return the figures of the newest row that was not late, None before it; they are not copied."""
        if self._last is None:
            return None
        outcome, model = self._last
        levels_db = (outcome.deviation.deviation_db, outcome.fix.residual_db, outcome.fix.sigma_db)
        sensitivity = model.sensitivity
        no_hypothesis = np.zeros(len(sensitivity.carrier_ids), dtype=np.int64)
        return CarrierLevels(sensitivity.carrier_ids, *levels_db, sensitivity.is_selected, no_hypothesis)

    def command_evidence(self) -> CommandEvidence | None:
        """Return None: the method has no model of the noise."""
        return None

    def disturbance(self) -> Disturbance | None:
        """Return the torque that the loop has learned; None where it knows of none."""
        if self._model is None or self._model.inertia_kg_m2 is None or self._state is None:
            return None
        return loop_disturbance(self._state.loop, self._model.loop, self._model.inertia_kg_m2)

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
        return model, CalibratedColumns(model.expected.carrier_ids, plan)
