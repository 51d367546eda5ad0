"""Controllers: commands go ahead of their pulses, and the chain hears of those that were executed alone."""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest

from service.records.attitude import Axes
from service.records.catalogue import Onboard, Site, Spacecraft
from service.records.command import AppliedCommand, Pulse, TorqueCommand
from service.records.measurement import Measurement
from service.study.closed_loop.controllers import LEAD_S, ByChain, ByTruth, Idle, postponed
from service.study.closed_loop.plant_process import CommandReport, CraftTruth

NOTHING = Axes(0.0, 0.0, 0.0)
MEASUREMENT = Measurement(0, 0, 1, "sa-1", 1, np.zeros(0), None, feeds_estimator=True)
CRAFT = Spacecraft(
    "yamal-202",
    "",
    90.0,
    Site(55.0, 37.0),
    ((2600.0, 0.0, 0.0), (0.0, 1400.0, 0.0), (0.0, 0.0, 2600.0)),
    0.05,
    simulated=True,
    onboard=Onboard(fast_loop=True, forecast_mode=True),
)


def truth(roll_deg: float) -> CraftTruth:
    return CraftTruth(0, Axes(0.0, roll_deg, 0.0), NOTHING, 0.0)


def report(counter: int, state: str) -> CommandReport:
    return CommandReport(counter, state, NOTHING)


def command() -> TorqueCommand:
    told = ByTruth(CRAFT, 0.0, 60.0)
    decision = told.decide(MEASUREMENT, truth(0.5), 1)
    assert decision.schedule
    return TorqueCommand(
        *(0, 1, 0, "ground", NOTHING, (0.0,) * 3, False, 60.0, 60_000_000, decision.schedule),
        *(NOTHING, NOTHING, NOTHING, (0.0,) * 3, True, ()),
    )


@dataclass
class RecordedChain:
    """A chain that gives one command again and again and remembers what it was told."""

    command: TorqueCommand
    learned: list[AppliedCommand] = field(default_factory=list)

    def step(self, measurement: Measurement) -> SimpleNamespace:
        return SimpleNamespace(rows=(), command=self.command)

    def learn(self, content: AppliedCommand) -> None:
        self.learned.append(content)


def test_nobody_sends_nothing():
    assert Idle().decide(MEASUREMENT, truth(1.0), 1).schedule == ()


@pytest.mark.parametrize("roll_deg", [0.5, -0.5])
def test_perfect_sensing_pushes_against_the_angle(roll_deg):
    (pulse,) = ByTruth(CRAFT, LEAD_S, 60.0).decide(MEASUREMENT, truth(roll_deg), 1).schedule
    assert pulse.torque_n_m.roll * roll_deg < 0.0
    assert pulse.start_us == round(LEAD_S * 1e6)


def test_what_perfect_sensing_cannot_express_is_carried_on():
    controller = ByTruth(CRAFT, 0.0, 60.0)
    given = [controller.decide(MEASUREMENT, truth(0.001), k).schedule for k in range(200)]
    assert 0 < sum(map(bool, given)) < 200


def test_a_postponed_command_is_the_same_later():
    plain = command()
    later = postponed(plain, 90.0)
    assert later.schedule == tuple(Pulse(p.start_us + 90_000_000, p.duration_s, p.torque_n_m) for p in plain.schedule)
    assert replace(later, schedule=plain.schedule) == plain


def test_over_a_link_the_chain_hears_of_executed_commands_alone_and_once():
    chain = RecordedChain(command())
    controller = ByChain(chain, LEAD_S)
    for counter in range(1, 5):
        decision = controller.decide(MEASUREMENT, truth(0.0), counter)
        assert decision.schedule[0].start_us == round(LEAD_S * 1e6)
    assert chain.learned == []
    controller.hear((report(1, "executed"), report(2, "late"), report(1, "repeated"), report(1, "executed")))
    assert [applied.command.schedule for applied in chain.learned] == [postponed(command(), LEAD_S).schedule]
    controller.hear((report(99, "executed"), report(3, "refused")))
    assert len(chain.learned) == 1


def test_over_an_ideal_uplink_a_command_counts_from_its_epoch():
    chain = RecordedChain(command())
    ByChain(chain, 0.0).decide(MEASUREMENT, truth(0.0), 1)
    assert chain.learned == [AppliedCommand(command())]


def test_a_row_without_a_command_is_inhibited():
    chain = RecordedChain(replace(command(), control_allowed=False, schedule=()))
    controller = ByChain(chain, 0.0)
    assert controller.decide(MEASUREMENT, truth(0.0), 1).is_inhibited
    assert chain.learned == []
