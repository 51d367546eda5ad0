"""``soo demo inject``: what is asked reaches the simulator or is refused with a reason and an exit code."""

import json
import os
import socket
import threading

import pytest
from typer.testing import CliRunner

from service.cli.app import app
from service.cli.demonstration.running import RunningDemonstration, published

ANSWER = {
    "type": "changed",
    "change": "rain",
    "carrier": None,
    "from": "2026-11-05T10:00:00Z",
    "until": "2026-11-05T11:00:00Z",
}


@pytest.fixture(autouse=True)
def _own_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))


@pytest.fixture
def simulator():
    """Give a function that runs a port with one answer; it returns address and lines received."""
    servers = []

    def play(answer: bytes):
        server = socket.create_server(("127.0.0.1", 0))
        servers.append(server)
        received: list[bytes] = []

        def serve() -> None:
            connection, _ = server.accept()
            with connection, connection.makefile("rb") as lines:
                received.append(lines.readline())
                connection.sendall(answer)

        threading.Thread(target=serve, daemon=True).start()
        return server.getsockname()[:2], received

    yield play
    for server in servers:
        server.close()


def run(changes, *arguments):
    demonstration = RunningDemonstration(os.getpid(), "http://127.0.0.1:1", "absent.key", changes)
    with published(demonstration):
        return CliRunner().invoke(app, ["demo", "inject", *arguments])


def test_a_change_is_sent_and_what_is_to_be_seen_is_said(simulator):
    address, received = simulator(json.dumps(ANSWER).encode() + b"\n")
    ran = run(address, "rain", "--minutes", "60")
    assert (ran.exit_code, json.loads(received[0])) == (0, {"change": "rain", "duration_s": 3600.0})
    assert "until 2026-11-05T11:00:00Z" in ran.output
    assert "inhibited by a fade" in ran.output


def test_a_program_gets_the_answer(simulator):
    address, received = simulator(json.dumps(ANSWER).encode() + b"\n")
    ran = run(address, "step", "--carrier", "c03", "--json")
    assert json.loads(ran.output) == ANSWER
    assert json.loads(received[0])["carrier"] == "c03"


def test_a_refusal_of_the_simulator_is_a_wrong_option(simulator):
    address, _ = simulator(b'{"type":"error","detail":"there is no carrier c99"}\n')
    ran = run(address, "step", "--carrier", "c99")
    assert (ran.exit_code, ran.output) == (2, "nothing was changed: there is no carrier c99\n")


def test_a_simulator_that_leaves_is_away(simulator):
    address, _ = simulator(b"")
    assert run(address, "rain").exit_code == 1


def test_a_port_that_is_closed_is_away():
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = server.getsockname()[:2]
    ran = run(address, "rain")
    assert ran.exit_code == 1
    assert "does not answer" in ran.output


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("rain", "--carrier", "c00"), 2, "leave --carrier out"),
        (("rain",), 1, "without --open"),
        (("stop",), 1, "does not answer"),
        (("snow",), 2, "snow"),
    ],
)
def test_what_cannot_be_done_is_refused(arguments, code, words):
    ran = run(None, *arguments)
    assert ran.exit_code == code
    assert words in ran.output
