"""Control centre of two persons: released commands alone go up, once, and what became of them is reported."""

import pytest

from service.client.problem import ProblemError
from service.study.demonstration.spacecraft_line import SpacecraftReport
from service.study.demonstration.two_step_centre import RowPaces, TwoStepCentre

NO_WAIT = RowPaces(0.0, 0.0, 0.0)
IMPULSE = dict.fromkeys(("yaw", "roll", "pitch"), 0.0)


def epoch(minute: int, second: int = 0) -> str:
    return f"2026-11-05T10:{minute:02d}:{second:02d}.000000Z"


PULSES = [
    {"start": epoch(minute), "duration_s": 5.0, "roll_n_m": 0.002, "pitch_n_m": 0.0, "yaw_n_m": 0.0}
    for minute in (4, 6)
]


def report(state: str, until: str | None = None) -> SpacecraftReport:
    return SpacecraftReport(1, state, epoch(9), None, until, IMPULSE)


class Service:
    """A service whose control is set by the test; a refusal is raised for every report."""

    def __init__(self, *reasons: str, released: tuple[int, ...] = (), refusal: str = "") -> None:
        self.reasons, self.released, self.refusal = list(reasons), list(released), refusal
        self.log: list[tuple] = []

    def torques(self, _spacecraft_id):
        return {"attitude_epoch": epoch(59)}

    def control(self, _spacecraft_id):
        return {
            "control": {"allowed": not set(self.reasons) - {"yaw_sign"}},
            "reasons": self.reasons,
            "armed": "not_armed" not in self.reasons,
            "open_commands": [],
            "unreported_commands": self.released,
        }

    def order_control(self, _spacecraft_id, order, _comment):
        self.log.append((order,))
        self._refuse("interlock.")
        return self.control(_spacecraft_id)

    def uplink(self, _spacecraft_id, _counter):
        return {"schedule": PULSES}

    def report_torques(self, _spacecraft_id, counter, turn, **part):
        self._refuse()
        self.log.append((turn, counter, part.get("executed_until")))

    def _refuse(self, *codes):
        if self.refusal.startswith(codes or ("command.", "auth.")):
            raise ProblemError(409, self.refusal, "refused")


class Line:
    """A spacecraft that says a script of reports, one list a row."""

    def __init__(self, *reports: list) -> None:
        self.reports, self.sent = list(reports), []

    def send(self, schedule, counter):
        self.sent.append((schedule, counter))

    def await_flown(self, _epoch):
        return self.reports.pop(0) if self.reports else []


def steered(service: Service, line: Line, rows: int = 2) -> TwoStepCentre:
    centre = TwoStepCentre(service, line, operator=service, paces=NO_WAIT)
    for minute in range(rows):
        centre.steer("sc", epoch(minute))
    return centre


def test_nothing_goes_up_that_nobody_released():
    service, line = Service("yaw_sign"), Line()
    assert steered(service, line).log.counts()["sent"] == 0
    assert line.sent == []


def test_a_released_command_goes_up_once_and_is_reported_sent():
    service, line = Service("yaw_sign", released=(1,)), Line()
    steered(service, line, rows=3)
    assert line.sent == [(PULSES, 1)]
    assert [entry for entry in service.log if entry[0] == "sent"] == [("sent", 1, None)]


@pytest.mark.parametrize(
    ("said", "reported"),
    [
        (report("executed", epoch(6, 5)), ("executed", 1, None)),
        (report("executed", epoch(4, 5)), ("executed", 1, epoch(4, 5))),
        (report("late"), ("failed", 1, None)),
        (report("refused"), ("failed", 1, None)),
        (report("replaced"), ("failed", 1, None)),
    ],
)
def test_what_became_of_a_command_is_reported(said, reported):
    service = Service("yaw_sign", released=(1,))
    steered(service, Line([], [said]))
    assert service.log[-1] == reported


def test_a_command_that_goes_on_is_not_reported():
    service = Service("yaw_sign", released=(1,))
    steered(service, Line([], [report("executing", epoch(4, 5))]))
    assert service.log[-1] == ("sent", 1, None)


def test_control_is_armed_once_and_not_while_anything_else_withholds_it():
    service = Service("not_armed", "fade")
    centre = steered(service, Line())
    assert (centre.is_armed, service.log, dict(centre.log.inhibitions)) == (False, [], {"not_armed": 2, "fade": 2})
    service.reasons.remove("fade")
    for minute in (3, 4):
        centre.steer("sc", epoch(minute))
    assert (centre.is_armed, service.log) == (True, [("arm",)])


def test_a_refused_arming_is_tried_again_with_the_next_row():
    service = Service("not_armed", refusal="interlock.inhibited")
    assert (steered(service, Line()).is_armed, service.log) == (False, [("arm",), ("arm",)])


@pytest.mark.parametrize("code", ["command.state", "command.unknown"])
def test_a_person_who_reported_before_is_no_failure(code):
    service = Service("yaw_sign", released=(1,), refusal=code)
    assert steered(service, Line([], [report("late")])).log.counts()["late"] == 1


def test_another_refusal_ends_the_demonstration():
    with pytest.raises(ProblemError):
        steered(Service("yaw_sign", released=(1,), refusal="auth.key"), Line())
