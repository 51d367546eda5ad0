"""The demonstration's control centre, its link to the ground and its line to the spacecraft."""

import json
import socket
import threading

import pytest

from service.client.problem import ProblemError
from service.records.epoch import parse_epoch
from service.records.levels.attitude import NO_ANGLES
from service.study.closed_loop.plant_process import CommandReport
from service.study.demonstration import control_centre
from service.study.demonstration.control_centre import (
    ControlCentre,
    RowPaces,
    SpacecraftLine,
    SpacecraftLineError,
    TwoStepCentre,
)
from service.study.demonstration.processes import GroundLink


def epoch(minute, second=0):
    return f"2026-11-05T10:{minute:02d}:{second:02d}.000000Z"


def pulse(minute, roll_n_m=0.002, duration_s=5.0):
    return {"start": epoch(minute), "duration_s": duration_s, "roll_n_m": roll_n_m, "pitch_n_m": 0.0, "yaw_n_m": 0.0}


def command(minute, *schedule, inhibitions=()):
    control = {"allowed": not inhibitions, "reasons": [{"code": code} for code in inhibitions]}
    return {"attitude_epoch": epoch(minute), "schedule": list(schedule), "control": control}


def report(counter, state="executed", until="2026-11-05T10:59:00.000000Z"):
    return CommandReport(counter, state, NO_ANGLES, 0, parse_epoch(until) if state == "executed" else None)


class Service:
    """Tells a script of commands, one a request."""

    def __init__(self, *reported):
        self.reported, self.asked = list(reported), 0

    def torques(self, _spacecraft_id):
        self.asked += 1
        return self.reported.pop(0) if len(self.reported) > 1 else self.reported[0]


class Line:
    """A spacecraft that tells a script of reports, one list a row."""

    def __init__(self, *reports):
        self.reports, self.sent = list(reports), []

    def send(self, schedule, counter):
        self.sent.append((schedule, counter))

    def await_flown(self, _epoch):
        return self.reports.pop(0) if self.reports else []


def steered(service, line, *minutes):
    centre = ControlCentre(service, line)
    for minute in minutes:
        centre.steer("sc", epoch(minute))
    return centre


def test_the_command_of_the_row_goes_up_once_it_is_there():
    before = {**command(0), "attitude_epoch": None}
    service, line = Service(before, command(0), command(1, pulse(1))), Line()
    centre = steered(service, line, 1)
    assert service.asked == 3
    assert line.sent == [([pulse(1)], 1)]
    assert (centre.log.rows, centre.log.counts()["sent"]) == (1, 1)


def test_nothing_goes_up_where_nothing_is_wanted_or_allowed():
    service = Service(command(0), command(1, inhibitions=("fade", "gap")), command(2, pulse(2)))
    line = Line()
    log = steered(service, line, 0, 1, 2).log
    assert line.sent == [([pulse(2)], 1)]
    assert (log.rows, log.inhibited_rows, dict(log.inhibitions)) == (3, 1, {"fade": 1, "gap": 1})


def test_what_became_of_each_command_is_counted():
    minutes = range(7)
    service = Service(*(command(minute, pulse(minute)) for minute in minutes))
    reports = [
        [],
        [report(1)],
        [report(2, "late")],
        [report(3, "executing"), report(1, "repeated")],
        [report(3)],
        [report(4, "replaced")],
    ]
    log = steered(service, Line(*reports), *minutes).log
    reported = {"executed": 2, "executing": 0, "replaced": 1, "late": 1, "refused": 0}
    # the fifth ended more than five minutes before nothing; two more are on their way
    assert log.counts() == {"sent": 7, **reported, "lost": 0, "under_way": 3, "twice": 1}
    log.newest_us += 4 * 60_000_000
    assert (log.counts()["lost"], log.counts()["under_way"]) == (1, 2)
    assert log.impulse_n_m_s == pytest.approx({"yaw": 0.0, "roll": 0.02, "pitch": 0.0})


def test_what_had_not_begun_when_a_command_was_replaced_is_no_impulse():
    service = Service(command(0, pulse(0), pulse(3, roll_n_m=-0.004)), command(1))
    log = steered(service, Line([], [report(1, until=epoch(0, 5))]), 0, 1).log
    assert log.impulse_n_m_s["roll"] == pytest.approx(0.01)


def test_a_service_that_computes_nothing_is_not_waited_for_for_ever(monkeypatch):
    monkeypatch.setattr(control_centre, "_COMMAND_TIMEOUT_S", 0.1)
    with pytest.raises(TimeoutError, match="no command of 2026-11-05T10:01"):
        steered(Service(command(0)), Line(), 1)


NO_WAIT = RowPaces(0.0, 0.0, 0.0)


PULSES = [pulse(4), pulse(6)]


def said_report(state, until=None):
    return CommandReport(1, state, NO_ANGLES, 0, None if until is None else parse_epoch(until))


class RefusingService:
    """A service whose control is set by the test; a refusal is raised for every report."""

    def __init__(self, *reasons, released=(), refusal=""):
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


def steered_in_two(service, line, rows=2):
    centre = TwoStepCentre(service, line, operator=service, paces=NO_WAIT)
    for minute in range(rows):
        centre.steer("sc", epoch(minute))
    return centre


def test_nothing_goes_up_that_nobody_released():
    service, line = RefusingService("yaw_sign"), Line()
    assert steered_in_two(service, line).log.counts()["sent"] == 0
    assert line.sent == []


def test_a_released_command_goes_up_once_and_is_reported_sent():
    service, line = RefusingService("yaw_sign", released=(1,)), Line()
    steered_in_two(service, line, rows=3)
    assert line.sent == [(PULSES, 1)]
    assert [entry for entry in service.log if entry[0] == "sent"] == [("sent", 1, None)]


@pytest.mark.parametrize(
    ("said", "reported"),
    [
        (said_report("executed", epoch(6, 5)), ("executed", 1, None)),
        (said_report("executed", epoch(4, 5)), ("executed", 1, parse_epoch(epoch(4, 5)))),
        (said_report("late"), ("failed", 1, None)),
        (said_report("refused"), ("failed", 1, None)),
        (said_report("replaced"), ("failed", 1, None)),
    ],
)
def test_what_became_of_a_command_is_reported(said, reported):
    service = RefusingService("yaw_sign", released=(1,))
    steered_in_two(service, Line([], [said]))
    assert service.log[-1] == reported


def test_a_command_that_goes_on_is_not_reported():
    service = RefusingService("yaw_sign", released=(1,))
    steered_in_two(service, Line([], [said_report("executing", epoch(4, 5))]))
    assert service.log[-1] == ("sent", 1, None)


def test_control_is_armed_once_and_not_while_anything_else_withholds_it():
    service = RefusingService("not_armed", "fade")
    centre = steered_in_two(service, Line())
    assert (centre.is_armed, service.log, dict(centre.log.inhibitions)) == (False, [], {"not_armed": 2, "fade": 2})
    service.reasons.remove("fade")
    for minute in (3, 4):
        centre.steer("sc", epoch(minute))
    assert (centre.is_armed, service.log) == (True, [("arm",)])


def test_a_refused_arming_is_tried_again_with_the_next_row():
    service = RefusingService("not_armed", refusal="interlock.inhibited")
    assert (steered_in_two(service, Line()).is_armed, service.log) == (False, [("arm",), ("arm",)])


@pytest.mark.parametrize("code", ["command.state", "command.unknown"])
def test_a_person_who_reported_before_is_no_failure(code):
    service = RefusingService("yaw_sign", released=(1,), refusal=code)
    assert steered_in_two(service, Line([], [said_report("late")])).log.counts()["late"] == 1


def test_another_refusal_ends_the_demonstration():
    with pytest.raises(ProblemError):
        steered_in_two(RefusingService("yaw_sign", released=(1,), refusal="auth.key"), Line())


FED_FORWARD = {"epoch": "2026-11-05T10:00:00.000000Z", "period_s": 86400.0}
START = {"type": "start", "scenario": "demo", "fed_forward_torque": FED_FORWARD}
NOTHING = {"yaw": 0.0, "roll": 0.0, "pitch": 0.0}


def told_report(counter, state, **fields):
    return {
        "type": "report",
        "counter": counter,
        "state": state,
        "told": epoch(1),
        "received": epoch(0),
        **fields,
    }


class OrbitalFrameSpacecraft:
    """A listening socket that says a script and keeps the lines it hears."""

    def __init__(self, script):
        self.heard: list[dict] = []
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = self._listener.getsockname()
        self._thread = threading.Thread(target=self._serve, args=(script,), daemon=True)
        self._thread.start()

    def _serve(self, script):
        connection, _ = self._listener.accept()
        with connection, connection.makefile("rb") as lines:
            connection.sendall(b"".join(json.dumps(line).encode() + b"\n" for line in (START, *script)))
            connection.shutdown(socket.SHUT_WR)
            self.heard = [json.loads(line) for line in lines]

    def end(self):
        self._thread.join(120)
        self._listener.close()


@pytest.fixture
def record():
    crafts = []

    def start(*script):
        crafts.append(OrbitalFrameSpacecraft(list(script)))
        return crafts[-1]

    yield start
    for one in crafts:
        one.end()


def test_reports_are_kept_until_the_row_they_belong_to_is_asked_for(record):
    executed = told_report(
        1,
        "executed",
        executed_from=epoch(0),
        executed_until=epoch(1),
        impulse_n_m_s={**NOTHING, "roll": 0.02},
    )
    reported = record(
        {"type": "flown", "epoch": epoch(0)},
        {"type": "taken", "counter": 1, "sent": epoch(0)},
        executed,
        {"type": "flown", "epoch": epoch(1)},
        told_report(1, "repeated"),
        {"type": "flown", "epoch": epoch(2)},
    )
    with SpacecraftLine(*reported.address, timeout_s=120.0) as line:
        assert line.fed_forward == FED_FORWARD
        assert line.await_flown(epoch(0)) == []
        line.send([{"start": epoch(0)}], 1)
        (first,) = line.await_flown(epoch(1))
        (second,) = line.await_flown(epoch(2))
        assert line.await_flown(epoch(2)) == [], "a row that was flown is not waited for"
    reported.end()
    assert reported.heard == [{"schedule": [{"start": epoch(0)}], "counter": 1}]
    assert (first.state, first.executed_until_us, first.impulse_n_m_s.roll) == ("executed", parse_epoch(epoch(1)), 0.02)
    assert (second.state, second.executed_until_us, second.impulse_n_m_s) == ("repeated", None, (0.0, 0.0, 0.0))


def test_a_refused_schedule_is_told_with_its_reason(record):
    reported = record({"type": "error", "detail": "element 0: a torque exceeds 0.05 N m"})
    with (
        SpacecraftLine(*reported.address, timeout_s=120.0) as line,
        pytest.raises(SpacecraftLineError, match=r"refused: element 0: a torque exceeds 0\.05 N m"),
    ):
        line.send([{}], 1)


def test_a_line_that_another_client_holds_is_told(record):
    with socket.create_server(("127.0.0.1", 0)) as listener:
        address = listener.getsockname()

        def turn_away():
            connection, _ = listener.accept()
            connection.sendall(b'{"type":"error","detail":"another client holds the uplink"}\n')
            connection.close()

        thread = threading.Thread(target=turn_away, daemon=True)
        thread.start()
        with pytest.raises(SpacecraftLineError, match="another client"):
            SpacecraftLine(*address, timeout_s=120.0)
        thread.join(120)


def test_a_craft_that_leaves_ends_the_wait(record):
    reported = record({"type": "flown", "epoch": epoch(0)})
    with (
        SpacecraftLine(*reported.address, timeout_s=120.0) as line,
        pytest.raises(SpacecraftLineError, match="closed its line"),
    ):
        line.await_flown(epoch(1))


@pytest.fixture
def simulator():
    """A listening socket on a free port."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        yield listener


def answer_one(listener, lines, heard):
    """Accept one client, send lines, wait for one answer."""

    def serve():
        connection, _ = listener.accept()
        with connection:
            connection.sendall(lines)
            heard.append(connection.makefile("rb").readline())

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    return thread


def test_messages_come_in_order_until_the_end_and_a_hold_is_answered(simulator):
    heard = []
    lines = b'{"kind":"phase","name":"quiet"}\n{"kind":"hold"}\n{"kind":"end"}\n{"kind":"after"}\n'
    thread = answer_one(simulator, lines, heard)
    kinds = []
    with GroundLink(*simulator.getsockname(), timeout_s=120.0) as link:
        for message in link.messages():
            kinds.append(message["kind"])
            if message["kind"] == "hold":
                link.proceed()
    thread.join(120)
    assert kinds == ["phase", "hold", "end"]
    assert heard == [b'{"kind":"proceed"}\n']


def test_a_simulator_that_leaves_ends_the_messages(simulator):
    def leave():
        connection, _ = simulator.accept()
        connection.sendall(b'{"kind":"phase"}\n')
        connection.close()

    thread = threading.Thread(target=leave, daemon=True)
    thread.start()
    with GroundLink(*simulator.getsockname(), timeout_s=120.0) as link:
        assert [message["kind"] for message in link.messages()] == ["phase"]
    thread.join(120)


def test_silence_is_not_waited_for_for_ever(simulator):
    with GroundLink(*simulator.getsockname(), timeout_s=0.05) as link, pytest.raises(TimeoutError):
        next(link.messages())
