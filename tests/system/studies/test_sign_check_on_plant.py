"""The sign check against the plant: a wheel whose sign is wrong is found before a tenth of a degree is lost."""

from dataclasses import replace

import numpy as np
import pytest

from service.core.control.sign_check import SignState
from service.pipeline.config import TorqueConfig
from service.pipeline.control.command.control_design import control_design
from service.pipeline.control.release.release_checks import schedule_of
from service.pipeline.control.release.sign_checks import RUNNING, is_leg_due
from service.pipeline.inputs.knowledge import JournalDocuments
from service.records.epoch import US_PER_S
from service.records.levels.attitude import Axes, Pulse
from service.records.operations.release import SignCheck
from service.runtime.control.sign_check_rows import SignCheckRows
from service.study.closed_loop.controllers import LEAD_S, Sensing
from service.study.closed_loop.ground_knowledge import ground_of
from service.study.closed_loop.plant_process import PlantProcess, PlantRow
from service.study.closed_loop.run import GroundJournal, LoopUnit, controller_of

pytestmark = [pytest.mark.system, pytest.mark.slow]

SEED = 2


class CheckedCraft:
    """A spacecraft in the plant, the chain that hears its powers, and the sign check of one axis."""

    def __init__(self, plant: PlantProcess, axis: str) -> None:
        ground = ground_of(plant.opening())
        documents = JournalDocuments()
        plan = documents.add_plan(ground.carriers)
        unit = LoopUnit("nominal", SEED, Sensing.AUTOMATIC)
        self.controller = controller_of(unit, ground, documents, plan)
        self.journal = GroundJournal(ground, documents, plan.plan_id)
        self.plant, self.axis = plant, axis
        self.design = control_design(ground.spacecraft, TorqueConfig())
        self.check = SignCheck(axis, RUNNING, 0, "test", 0, 0, 0)
        self.rows: SignCheckRows | None = None
        self.sent: dict[int, tuple[Pulse, ...]] = {}

    def consume(self, row: PlantRow) -> SignState:
        """Take a row and send the next leg when it is due; return what the powers say."""
        self.journal.update(row, self.controller)
        self.controller.chain.step(self.journal.measurement(row))
        runner = self.controller.chain._runners[0]
        epoch_us = row.truth.epoch_us
        if self.rows is None:
            attitude = runner._last[0].row.attitude_deg
            self.rows = SignCheckRows(Axes(*attitude), self.design.gains.inertia_kg_m2, has_coupling=True)
        self.rows.append(epoch_us, runner._model.filter, runner._last[0].deviation_db)
        for report in row.reports:
            if report.state == "executed":
                flown = (*self.check.flown, self.sent[report.counter])
                self.check = replace(self.check, leg=None, flown=flown, legs_done=len(flown))
        self.plant.send(*self._leg(epoch_us + round(LEAD_S * US_PER_S)))
        decision = self.rows.decision(self.check)
        return SignState.OPEN if decision is None else decision.verdict

    def _leg(self, start_us: int) -> tuple[tuple[Pulse, ...], int | None]:
        """Return the next leg and its counter; nothing where none is due."""
        if not is_leg_due(self.check, start_us):
            return (), None
        pulses = schedule_of(self.rows.leg(self.check, self.design.drive), start_us)
        counter = len(self.sent) + 1
        self.sent[counter] = pulses
        self.check = replace(self.check, leg=counter, leg_start_us=start_us)
        return pulses, counter


@pytest.mark.parametrize(
    ("axis", "response", "expected"),
    [
        ("roll", "roll=-1", SignState.MINUS),
        ("roll", "roll=1", SignState.PLUS),
        pytest.param("pitch", "pitch=-1", SignState.MINUS, marks=pytest.mark.nightly),
    ],
)
def test_a_wrong_wheel_sign_is_found_before_a_tenth_of_a_degree_is_lost(axis, response, expected):
    position = ("yaw", "roll", "pitch").index(axis)
    with PlantProcess("nominal", SEED, "link", 0.05, ("--response", response)) as plant:
        record = CheckedCraft(plant, axis)
        angles, verdict = [], SignState.OPEN
        for row in plant.rows():
            angles.append(row.truth.attitude_deg[position])
            verdict = record.consume(row)
            if verdict is not SignState.OPEN:
                break
    lost = float(np.abs(np.array(angles) - angles[0]).max())
    print(f"seed {SEED}, {response}: {verdict.value} after {len(angles)} min, {lost:.3f} deg of {axis} lost")
    assert verdict is expected
    assert lost < 0.1
    # the time of the check, and the way of its first leg to the spacecraft
    assert len(angles) <= 45 + LEAD_S / 60.0
