"""Connection of a command: a refusal ends it with the words of the service, an older service is said to be one."""

from typing import Any

import httpx
import pytest
import typer
from typer.testing import CliRunner

from service.cli.app import app
from service.cli.operation.connection import connected


@pytest.mark.parametrize(
    ("status", "code", "is_older"),
    [(404, "path.unknown", True), (405, "method.not_allowed", True), (404, "spacecraft.unknown", False)],
)
def test_a_request_that_the_service_does_not_know_is_one_for_a_newer_service(
    status: int, code: str, is_older: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    said = said_of(status, {"code": code, "detail": "there is none", "next_step": "Look."}, monkeypatch, capsys)
    assert f"{status} {code}: there is none" in said
    assert ("update the service, or use the soo of its version" in said) == is_older
    assert ("\nNext: Look.\n" in said) != is_older


def test_faulty_fields_stand_below_the_detail_and_the_next_step_last(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    errors = [
        {"pointer": f"/carriers/{k}/id", "code": "carrier.duplicate", "detail": f"two have {k}"} for k in range(14)
    ]
    problem = {"code": "request.invalid", "detail": "14 fields are invalid", "next_step": "Correct them."}
    head = "422 request.invalid: 14 fields are invalid (request r-1)"
    listed = [f"  /carriers/{k}/id: two have {k}" for k in range(14)]
    whole = {**problem, "request_id": "r-1", "errors": errors[:12]}
    assert said_of(422, whole, monkeypatch, capsys).splitlines() == [head, *listed[:12], "Next: Correct them."]
    more = {**whole, "errors": errors}
    lines = said_of(422, more, monkeypatch, capsys).splitlines()
    assert lines == [head, *listed[:12], "  (and 2 more)", "Next: Correct them."]
    # a fault of the whole document, and an answer of an older service
    older = {"code": "json.malformed", "detail": "the body is wrong", "errors": [{"pointer": "", "detail": "is empty"}]}
    assert said_of(400, older, monkeypatch, capsys) == "400 json.malformed: the body is wrong\n  /: is empty\n"


def test_the_only_fault_is_not_said_twice_and_a_busy_service_says_its_next_step_too(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    named = {"code": "value.range", "detail": "/a: must be 1", "errors": [{"pointer": "/a", "detail": "must be 1"}]}
    assert said_of(422, named, monkeypatch, capsys) == "422 value.range: /a: must be 1\n"
    placed = {**named, "detail": "must be 1"}
    assert said_of(422, placed, monkeypatch, capsys) == "422 value.range: must be 1\n  /a\n"
    busy = {"code": "storage.closed", "detail": "The archive is closing.", "next_step": "Wait."}
    said = said_of(503, busy, monkeypatch, capsys, retries=0)
    assert said == "503 storage.closed: The archive is closing. Next: Wait.\n"


def said_of(
    status: int,
    problem: dict[str, Any],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    **options: Any,
) -> str:
    """Return what a command prints of a problem, ended with 1."""
    monkeypatch.setenv("SOO_KEY", "a-key")
    http = httpx.MockTransport(lambda _: httpx.Response(status, json=problem))
    with (
        pytest.raises(typer.Exit) as ended,
        connected("http://127.0.0.1:9", "SOO_KEY", http=http, **options) as client,
    ):
        client.status("yamal-202")
    assert ended.value.exit_code == 1
    return capsys.readouterr().err


def test_a_key_that_the_service_does_not_know_is_said_to_come_from_somewhere(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    said = said_of(401, {"code": "key.invalid", "detail": "There is none.", "next_step": "Send."}, monkeypatch, capsys)
    start = "401 key.invalid: There is none.\nNext: correct the key of SOO_KEY, of the file of SOO_KEY_FILE, or of /"
    assert said.startswith(start)


@pytest.mark.parametrize("address", ["127.0.0.1:8000", "ftp://127.0.0.1", "service"])
def test_an_address_of_no_service_is_a_wrong_option(address: str) -> None:
    done = CliRunner().invoke(app, ["status"], env={"SOO_URL": address, "SOO_KEY": "a-key"})
    assert done.exit_code == 2
    assert f"{address!r} is no address of a service: state http://HOST:PORT" in done.stderr
