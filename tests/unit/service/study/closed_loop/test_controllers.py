"""Controllers: commands go ahead of their pulses, and the chain hears of those that were executed alone."""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest

from service.records.catalogue import ControlSettings, Onboard, Release, Site, Spacecraft
from service.records.levels.attitude import Axes
from service.records.levels.command import AppliedCommand, Pulse, TorqueCommand
from service.records.levels.measurement import Measurement
from service.study.closed_loop.controllers import LEAD_S, ByAngles, ByChain, ByTruth, Idle, postponed
from service.study.closed_loop.plant_process import CommandReport, SpacecraftTruth

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
    control=ControlSettings(release=Release.AUTOMATIC),
)


def truth(roll_deg: float) -> SpacecraftTruth:
    return SpacecraftTruth(0, Axes(0.0, roll_deg, 0.0), NOTHING, 0.0)


def command() -> TorqueCommand:
    announced = ByTruth(CRAFT, 0.0, 60.0)
    decision = announced.decide(MEASUREMENT, truth(0.5), 1)
    assert decision.schedule
    return TorqueCommand(
        *(0, 1, 0, "ground", NOTHING, (0.0,) * 3, False, 60.0, 60_000_000, decision.schedule),
        *(NOTHING, NOTHING, NOTHING, (0.0,) * 3, True, ()),
    )


@dataclass
class RecordedChain:
    """A chain that gives one command again and again and remembers what it was told."""

    command: TorqueCommand
    identified: list[AppliedCommand] = field(default_factory=list)

    def step(self, measurement: Measurement) -> SimpleNamespace:
        applied = AppliedCommand(self.command) if self.command.control_allowed else None
        return SimpleNamespace(rows=(), command=self.command, applied=applied)

    def update(self, content: AppliedCommand) -> None:
        self.identified.append(content)


def test_the_chain_hears_the_mean_torque_of_what_a_loop_on_board_has_done():
    announced = command()
    chain = RecordedChain(announced)
    controller = ByAngles(chain, announced)
    impulse = Axes(0.0, 0.012, -0.006)
    executed = CommandReport(4, "executed", impulse, 120_000_000, 66_000_000, 60_000_000)
    controller.on_input((executed, CommandReport(5, "refused", NOTHING), replace_state(executed, "repeated")))
    (applied,) = chain.identified
    (pulse,) = applied.command.schedule
    assert (pulse.start_us, pulse.duration_s) == (60_000_000, 6.0)
    assert pulse.torque_n_m == pytest.approx((0.0, 0.002, -0.001))


def replace_state(report: CommandReport, state: str) -> CommandReport:
    return report._replace(state=state)


def test_nobody_sends_nothing():
    assert Idle().decide(MEASUREMENT, truth(1.0), 1).schedule == ()


@pytest.mark.parametrize("roll_deg", [0.5, -0.5])
def test_perfect_sensing_pushes_against_the_angle(roll_deg):
    (pulse,) = [
        p for p in ByTruth(CRAFT, LEAD_S, 60.0).decide(MEASUREMENT, truth(roll_deg), 1).schedule if p.torque_n_m.roll
    ]
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


def test_perfect_sensing_sees_roll_and_yaw_exchange():
    turned = truth(0.0)._replace(attitude_deg=Axes(1.0, 0.0, 0.0))
    given = [p for p in ByTruth(CRAFT, 0.0, 60.0).decide(MEASUREMENT, turned, 1).schedule if p.torque_n_m.roll]
    # yaw of 1 deg turns roll by 0.26 deg/h, which the law holds up
    assert given
    assert given[0].torque_n_m.roll < 0.0


def test_over_an_ideal_uplink_a_command_counts_from_its_epoch():
    chain = RecordedChain(command())
    decision = ByChain(chain).decide(MEASUREMENT, truth(0.0), 1)
    assert decision.schedule == command().schedule
    assert chain.identified == [AppliedCommand(command())]


def test_a_row_without_a_command_is_inhibited():
    chain = RecordedChain(replace(command(), control_allowed=False, schedule=()))
    controller = ByChain(chain)
    assert controller.decide(MEASUREMENT, truth(0.0), 1).is_inhibited
    controller.on_input((CommandReport(1, "executed", NOTHING),))
    assert chain.identified == []
