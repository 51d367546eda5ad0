"""The demonstration's link to the ground and its line to the spacecraft."""

import json
import socket
import threading

import pytest

from service.study.demonstration.ground_link import GroundLink
from service.study.demonstration.spacecraft_line import SpacecraftLine, SpacecraftLineError

FED_FORWARD = {"epoch": "2026-11-05T10:00:00.000000Z", "period_s": 86400.0}
START = {"type": "start", "scenario": "demo", "fed_forward_torque": FED_FORWARD}
NOTHING = {"yaw": 0.0, "roll": 0.0, "pitch": 0.0}


def epoch(minute):
    return f"2026-11-05T10:{minute:02d}:00.000000Z"


def report(counter, state, **fields):
    return {"type": "report", "counter": counter, "state": state, "told": epoch(1), "received": epoch(0), **fields}


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
    executed = report(
        1, "executed", executed_from=epoch(0), executed_until=epoch(1), impulse_n_m_s={**NOTHING, "roll": 0.02}
    )
    reported = record(
        {"type": "flown", "epoch": epoch(0)},
        {"type": "taken", "counter": 1, "sent": epoch(0)},
        executed,
        {"type": "flown", "epoch": epoch(1)},
        report(1, "repeated"),
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
    assert (first.state, first.executed_until, first.impulse_n_m_s["roll"]) == ("executed", epoch(1), 0.02)
    assert (second.state, second.executed_until, second.impulse_n_m_s) == ("repeated", None, NOTHING)


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
