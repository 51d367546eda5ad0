"""Release over a link: one command at a time, known to the chain only by its report."""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest

from service.pipeline.config import TorqueConfig
from service.records.catalogue import ControlSettings, Method, Onboard, Release, Site, Spacecraft
from service.records.levels.attitude import Axes, row_without_attitude
from service.records.levels.command import AppliedCommand, Pulse, ReleasedCommand, ReportedCommand
from service.records.levels.disturbance import Disturbance
from service.records.levels.measurement import Measurement
from service.study.closed_loop.plant_process import CommandReport
from service.study.closed_loop.released import Releaser

S = 1_000_000
ZERO = Axes(0.0, 0.0, 0.0)
LEAD_S, PERIOD_S = 150.0, 600.0
CRAFT = Spacecraft(
    "yamal-202",
    "",
    90.0,
    Site(55.0, 37.0),
    ((2600.0, 0.0, 0.0), (0.0, 1400.0, 0.0), (0.0, 0.0, 2600.0)),
    0.05,
    simulated=True,
    onboard=Onboard(fast_loop=True, forecast_mode=True),
    control=ControlSettings(release=Release.TWO_STEP, command_period_s=PERIOD_S),
)
#: needs a pulse every other slice, so that there is a tail
PUSHED = Disturbance(0, 86_400.0, Axes(0.0, 4e-7, 0.0), ZERO, ZERO, ZERO)


@dataclass
class Journal:
    """Stands for the chain: remembers what it was told."""

    announced: list[object] = field(default_factory=list)

    def update(self, content: object) -> None:
        self.announced.append(content)


class Link:
    """A releaser, row by row."""

    def __init__(self) -> None:
        self.journal = Journal()
        self.releaser = Releaser(self.journal, CRAFT, LEAD_S, TorqueConfig())
        self.sent = 0

    def row(self, at_s: float, roll_deg: float = 0.1, **changes) -> tuple[Pulse, ...]:
        plain = row_without_attitude(round(at_s * S), round(at_s * S), 1, Method.ROBUST, ())
        allowed = {"control_allowed": True, "control_allowed_axes": (True, True, True)}
        row = replace(plain, attitude_deg=Axes(0.0, roll_deg, 0.0), rates_deg_s=ZERO, **{**allowed, **changes})
        measurement = Measurement(row.epoch_us, row.epoch_us, 1, "sa-1", 1, np.zeros(0), None, feeds_estimator=True)
        given = self.releaser.wanted(SimpleNamespace(disturbance=PUSHED), row, measurement, self.sent + 1)
        self.sent += bool(given)
        return given

    def on_input(self, state: str, until_us: int | None = None, counter: int = 1) -> None:
        self.releaser.on_input([CommandReport(counter, state, ZERO, until_us or 0, until_us)])


@pytest.fixture
def link() -> Link:
    return Link()


def stop_us(pulse: Pulse) -> int:
    return pulse.start_us + round(pulse.duration_s * S)


def slew(schedule: tuple[Pulse, ...]) -> tuple[Pulse, ...]:
    return tuple(pulse for pulse in schedule if pulse.start_us <= (LEAD_S + 0.75 * PERIOD_S) * S)


def test_a_command_goes_out_ahead_of_its_pulses_and_is_uncertain_until_it_is_told(link):
    sent = link.row(0.0)
    assert min(pulse.start_us for pulse in sent) == LEAD_S * S
    assert len(slew(sent)) < len(sent)
    assert link.journal.announced == [ReleasedCommand(1, 0, sent)]
    # waits for its report, and for the end of its period
    assert link.row(60.0) == ()
    first, last = slew(sent)[0], slew(sent)[-1]
    link.on_input("executing", stop_us(first))
    assert len(link.journal.announced) == 1
    link.on_input("executing", stop_us(last))
    assert link.journal.announced[1:] == [ReportedCommand(1, stop_us(last), slew(sent))]
    assert link.row(540.0) == ()
    assert link.row(600.0) != ()


def test_what_is_executed_after_the_report_is_told_as_it_comes_and_once(link):
    sent = link.row(0.0)
    link.on_input("executing", stop_us(slew(sent)[-1]))
    link.on_input("executing", stop_us(sent[-2]))
    link.on_input("executed", stop_us(sent[-1]))
    link.on_input("executed", stop_us(sent[-1]))
    later = [content for content in link.journal.announced[2:] if isinstance(content, AppliedCommand)]
    assert [pulse for content in later for pulse in content.command.schedule] == list(sent[len(slew(sent)) :])


@pytest.mark.parametrize("state", ["late", "refused", "replaced"])
def test_what_the_craft_does_not_execute_is_reported_as_nothing(link, state):
    link.row(0.0)
    link.on_input(state)
    assert link.journal.announced[1:] == [ReportedCommand(1, 0, ())]
    assert link.row(600.0) != ()


def test_what_is_lost_is_given_up_and_a_repetition_says_nothing(link):
    link.row(0.0)
    link.on_input("repeated")
    assert len(link.journal.announced) == 1
    over_s = LEAD_S + 0.75 * PERIOD_S + 60.0
    assert link.row(over_s - 1.0) == ()
    assert link.row(over_s) != ()
    assert link.journal.announced[1] == ReportedCommand(1, round(over_s * S), ())


def test_nothing_goes_out_under_an_inhibition_and_a_person_leads_back_from_afar(link):
    assert link.row(0.0, inhibitions=("downlink_fade",)) == ()
    beyond = {"inhibitions": ("beyond_validity",), "control_allowed_axes": (False, False, False)}
    assert link.row(60.0, 0.7, **beyond) == ()
    assert link.row(60.0, 0.5, inhibitions=("beyond_validity", "downlink_fade")) == ()
    back = link.row(60.0, 0.5, **beyond)
    assert sum(pulse.torque_n_m.roll * pulse.duration_s * -pulse.start_us for pulse in slew(back)) > 0.0
    assert not any(pulse.torque_n_m.yaw for pulse in back)
