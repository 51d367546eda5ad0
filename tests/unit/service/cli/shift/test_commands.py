"""Commands of a shift: exit codes, what they print, and what they send, against a service of documents."""

import json
from contextlib import nullcontext
from typing import Any

import pytest
from typer.testing import CliRunner

from service.cli.app import app
from service.cli.operation import connection
from service.cli.shift import control
from service.client.problem import ProblemError, ServiceUnavailableError

HOSTILE = "\x1b[2J\u009b31m\u202e"


@pytest.fixture
def service(documents: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    for module in (connection, control):
        monkeypatch.setattr(module, "connected", lambda _service, _key_env, **_: nullcontext(documents))
    return documents


def run(*command: str, **environment: str) -> Any:
    done = CliRunner().invoke(app, list(command), env={"SOO_SPACECRAFT": "yamal-202", "COLUMNS": "80", **environment})
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
    assert not {"\x1b", "\u009b", "\u202e"} & set(done.output)
    return done


@pytest.mark.parametrize(
    ("is_allowed", "state", "code"), [(True, "ARMED", 0), (False, "INHIBITED", 3), (False, "TRIPPED", 4)]
)
def test_the_exit_code_of_status_says_whether_torques_may_go(
    service: Any, is_allowed: bool, state: str, code: int
) -> None:
    service.verdict |= {"allowed": is_allowed, "state": state, "reasons": []}
    done = run("status")
    assert done.exit_code == code
    assert done.stdout.startswith("yamal-202: roll, pitch known to 0.04 deg, yaw to 0.41 deg;")
    assert json.loads(run("status", "--json").stdout) == service.status("")


def test_attitude_has_each_axis_with_its_limit(service: Any) -> None:
    done = run("attitude")
    assert done.exit_code == 0
    rows = [" ".join(line.split()) for line in done.stdout.splitlines()]
    assert "Roll -0.330 of 0.40 0.70 h 0.020 0.100 of 0.22 -0.330" in rows
    assert "Yaw +0.100 of 0.40 over a day 0.020 0.100 +0.100" in rows
    assert "Pitch +0.020 of 0.40 – 0.020 0.100 of 0.22 +0.020" in rows
    assert "c03 (fades on its uplink)" in " ".join(done.stdout.split())
    service.rows["robust"] |= {"status": "EXPIRED", "roll_deg": -0.5}
    lost = {"axis": "roll", "beyond": True, "rate_deg_h": None, "hours_to_limit": None}
    service.verdict |= {"situation": {**service.verdict["situation"], "axes": [lost]}}
    done = run("attitude")
    assert (done.exit_code, "-0.500 of 0.40  beyond it" in done.stdout) == (3, True)


def test_carriers_that_are_left_out_come_first(service: Any) -> None:
    done = run("carriers")
    assert done.exit_code == 3
    assert [line[:3] for line in done.stdout.splitlines() if line.startswith("c0")] == ["c03", "c00"]


def test_alarms_have_ids_and_next_steps(service: Any) -> None:
    done = run("alarms")
    assert (done.exit_code, "1 warning: angle beyond its limit roll 0.33 deg (20" in done.stdout) == (3, True)
    # what follows stands below its cause, with the epoch of its value
    service.alarms = [service.alarms[0] | {"children": [service.alarms[0] | {"condition": "protection_level"}]}]
    cause, child = run("alarms", COLUMNS="300").stdout.splitlines()
    assert "1 alarm follows from it" in cause
    assert child.startswith("  ")
    assert "roll 0.33 deg (20" in child
    service.alarms = []
    assert (run("alarms").exit_code, run("alarms").stdout) == (0, "yamal-202: no alarm\n")


def test_names_of_others_move_no_terminal(service: Any) -> None:
    service.alarms = [service.alarms[0] | {"thing": HOSTILE, "unit": HOSTILE}]
    service.rows["robust"]["excluded"] = [{"carrier": HOSTILE, "reason": HOSTILE}]
    service.command_document |= {"reason": HOSTILE, "prepared_by": HOSTILE}
    for command in (["alarms"], ["attitude"], ["watch"], ["torque", "confirm", "1", "--digest", "0" * 8]):
        run(*command)
    assert "�[2J�31m�" in run("alarms").stdout


@pytest.mark.parametrize(
    "command",
    [["status"], ["attitude"], ["carriers"], ["alarms"], ["ack", "1"], ["shelve", "1"], ["note", "x"]]
    + [["control", order] for order in ("arm", "stop", "reset")]
    + [["torque", "confirm", "1", "--digest", "7da0f923"]],
)
def test_programs_get_one_document_and_the_exit_code_of_the_text(service: Any, command: list[str]) -> None:
    for_people, for_programs = run(*command), run(*command, "--json")
    assert isinstance(json.loads(for_programs.stdout), dict)
    assert for_programs.exit_code == for_people.exit_code


def test_orders_send_what_was_typed(service: Any) -> None:
    assert run("ack", "1", "--comment", "known").exit_code == 0
    assert run("shelve", "1", "--hours", "2").exit_code == 0
    assert run("note", "NS-14 at noon", "--corrects", "3").exit_code == 0
    assert service.sent == [
        ("POST", "/alarms/1:acknowledge", {"comment": "known"}),
        ("POST", "/alarms/1:shelve", {"until": "2027-01-15T12:30:00.000000Z", "comment": ""}),
        ("POST", "/notes", {"text": "NS-14 at noon", "spacecraft_id": "yamal-202", "corrects": 3}),
    ]
    assert run("shelve", "1", "--hours", "25").exit_code == 2


def test_a_stop_is_confirmed_by_the_state_that_the_service_answers(service: Any) -> None:
    assert run("control", "stop", "--comment", "x").exit_code == 0
    assert service.sent == [("yamal-202", "stop", "x")]
    service.control_document["state"] = "ARMED"
    done = run("control", "stop")
    assert (done.exit_code, "has not confirmed the stop of yamal-202" in done.stderr) == (1, True)


@pytest.mark.parametrize(
    "error", [ServiceUnavailableError("no answer"), ProblemError(403, "key.forbidden", "a viewer may not")]
)
def test_a_stop_without_an_answer_says_that_control_may_go_on(service: Any, error: Exception) -> None:
    def order_control(*_: object) -> None:
        raise error

    service.order_control = order_control
    done = run("control", "stop")
    assert done.exit_code == 1
    assert "Control may go on: send it again, or stop it on board." in done.stderr
    assert str(error) in done.stderr


def test_a_command_is_confirmed_by_the_digest_that_was_shown(service: Any) -> None:
    digest = service.command_document["digest"]
    done = run("torque", "confirm", "1", "--digest", digest[:8].upper())
    assert done.exit_code == 0
    assert service.sent == [("yamal-202", 1, digest, "")]
    for shown in ("roll is off", digest, "Roll -2.00e-03", "Roll -0.0066, Pitch 0.0100 deg"):
        assert shown in done.stdout


@pytest.mark.parametrize("digest", ["", "7da0f92", "0" * 64, "       7"])
def test_another_digest_or_a_short_one_confirms_nothing(service: Any, digest: str) -> None:
    done = run("torque", "confirm", "1", "--digest", digest)
    assert (done.exit_code, service.sent) == (2, [])


def test_without_a_terminal_a_confirmation_needs_its_digest(service: Any) -> None:
    done = run("torque", "confirm", "1")
    assert (done.exit_code, "state --digest" in done.stderr, service.sent) == (2, True, [])


def test_a_command_that_is_not_prepared_cannot_be_confirmed(service: Any) -> None:
    service.command_document["state"] = "EXPIRED"
    done = run("torque", "confirm", "1", "--digest", "7da0f923")
    assert (done.exit_code, "command 1 is EXPIRED" in done.stderr, service.sent) == (1, True, [])


@pytest.mark.parametrize("command", ["status", "attitude", "watch"])
def test_an_answer_of_an_older_service_is_said_to_be_one(service: Any, command: str) -> None:
    service.verdict["reasons"] = []
    del service.control_document["conditions"]
    done = run(command)
    assert done.exit_code == 1
    assert "has no 'conditions': it is older than this command; update the service" in done.stderr


def test_without_a_terminal_watch_prints_one_screen(service: Any) -> None:
    done = run("watch", LINES="24")
    assert done.exit_code == 0
    lines = done.stdout.splitlines()
    assert "no torque: control is not armed" in lines[0]
    assert len(lines) <= 24
    assert max(map(len, lines)) <= 80
