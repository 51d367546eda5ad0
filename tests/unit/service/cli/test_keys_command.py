"""``soo keys``: what is asked of the service, and what is printed where."""

import json
from contextlib import contextmanager

import pytest
from typer.testing import CliRunner

from service.cli.administration import keys
from service.cli.app import app

ROW = {
    "id": "k7d2mzq9xa",
    "name": "olga",
    "role": "operator",
    "state": "valid",
    "expires_at": None,
    "last_used_at": "2026-11-22T10:00:00.000000Z",
}
MADE = {"id": "k7d2mzq9xa", "key": "soo_k7d2mzq9xa_secret", "name": "olga", "role": "operator", "expires_at": None}


@pytest.fixture
def asked(monkeypatch):
    """What was asked of a service that answers as ours does."""
    requests = []

    class Client:
        def request(self, method, path, body=None, *, params=None):
            requests.append((method, path, body, params))
            return {"POST": MADE, "GET": {"rows": [ROW]}, "DELETE": None}[method]

    @contextmanager
    def connected(service, key_env):
        yield Client()

    monkeypatch.setattr(keys, "connected", connected)
    return requests


def soo(*arguments):
    result = CliRunner().invoke(app, ["keys", *arguments])
    assert result.exit_code == 0, result.output
    return result


def test_the_key_alone_goes_to_standard_output(asked):
    made = soo("create", "--name", "olga", "--role", "operator", "--expires", "2027-12-31T00:00:00Z")
    assert made.stdout == MADE["key"] + "\n"
    assert "shown this once" in made.stderr
    assert MADE["key"] not in made.stderr
    body = {"name": "olga", "role": "operator", "expires_at": "2027-12-31T00:00:00Z"}
    assert asked == [("POST", "/keys", body, None)]
    assert json.loads(soo("create", "--name", "olga", "--role", "operator", "--json").stdout) == MADE


def test_keys_are_listed_in_lines_or_as_json(asked):
    line = soo("list").stdout
    assert line.split() == [ROW["id"], "valid", "operator", "expires", "never", "used", ROW["last_used_at"], "olga"]
    assert json.loads(soo("list", "--json", "--revoked").stdout) == [ROW]
    assert [params for *_, params in asked] == [{"revoked": "false"}, {"revoked": "true"}]


def test_a_key_is_revoked_by_its_id(asked):
    assert "k7d2mzq9xa is revoked" in soo("revoke", "k7d2mzq9xa").stdout
    assert asked == [("DELETE", "/keys/k7d2mzq9xa", None, None)]


def test_without_a_key_in_the_environment_nothing_is_asked(monkeypatch):
    monkeypatch.delenv("SOO_KEY", raising=False)
    result = CliRunner().invoke(app, ["keys", "list"])
    assert (result.exit_code, "SOO_KEY is empty" in result.output) == (2, True)
