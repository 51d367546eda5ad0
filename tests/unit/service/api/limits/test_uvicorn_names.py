"""Names of uvicorn that the bounded protocol leans on; a version without one of them fails here by its name."""

import inspect
import tomllib
from pathlib import Path

import pytest
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol, RequestResponseCycle

ROOT = Path(__file__).resolve().parents[5]
OVERRIDDEN = {
    "connection_made": ["transport"],
    "connection_lost": ["exc"],
    "data_received": ["data"],
    "on_message_begin": [],
    "on_url": ["url"],
    "on_header": ["name", "value"],
    "on_headers_complete": [],
    "on_message_complete": [],
    "send_400_response": ["msg"],
}


@pytest.mark.parametrize("name", list(OVERRIDDEN))
def test_a_method_that_is_overridden_is_there(name: str) -> None:
    assert list(inspect.signature(getattr(HttpToolsProtocol, name)).parameters)[1:] == OVERRIDDEN[name]


@pytest.mark.parametrize("name", ["client", "transport", "loop", "cycle"])
def test_an_attribute_that_is_read_is_set(name: str) -> None:
    assert f"self.{name}" in inspect.getsource(HttpToolsProtocol.__init__)


def test_a_cycle_says_whether_its_answer_began() -> None:
    assert "self.response_started" in inspect.getsource(RequestResponseCycle.__init__)


def test_the_version_is_bounded() -> None:
    wanted = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    assert any(each.startswith("uvicorn>=") and ",<" in each for each in wanted)
