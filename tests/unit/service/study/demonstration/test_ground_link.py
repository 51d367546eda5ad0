"""Ground link: lines in, the confirmation out."""

import socket
import threading

import pytest

from service.study.demonstration.ground_link import GroundLink


@pytest.fixture
def simulator():
    """A listening socket on a free port."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        yield listener


def report(listener, lines, heard):
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
    thread = report(simulator, lines, heard)
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
