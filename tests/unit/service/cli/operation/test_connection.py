"""Connection of a command: a refusal ends it with the words of the service, an older service is said to be one."""

import httpx
import pytest
import typer

from service.cli.operation.connection import connected


@pytest.mark.parametrize(
    ("status", "code", "is_older"),
    [(404, "path.unknown", True), (405, "method.not_allowed", True), (404, "spacecraft.unknown", False)],
)
def test_a_request_that_the_service_does_not_know_is_one_for_a_newer_service(
    status: int, code: str, is_older: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("SOO_KEY", "a-key")
    problem = {"code": code, "detail": "there is none"}
    http = httpx.MockTransport(lambda _: httpx.Response(status, json=problem))
    with (
        pytest.raises(typer.Exit) as ended,
        connected("http://127.0.0.1:9", "SOO_KEY", http=http) as client,
    ):
        client.status("yamal-202")
    said = capsys.readouterr().err
    assert ended.value.exit_code == 1
    assert f"{status} {code}: there is none" in said
    assert ("update the service, or use the soo of its version" in said) == is_older
