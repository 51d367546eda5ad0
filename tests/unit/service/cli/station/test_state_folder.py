"""State lies where the service manager, the user's settings or the home folder say, in this order."""

from pathlib import Path

import pytest

from service.cli.station.state_folder import state_folder


@pytest.mark.parametrize(
    ("given", "wanted"),
    [
        ({"STATE_DIRECTORY": "/var/lib/soo:/var/lib/other", "XDG_STATE_HOME": "/x"}, "/var/lib/soo/spool"),
        ({"XDG_STATE_HOME": "/x"}, "/x/soo/spool"),
        ({"HOME": "/h"}, "/h/.local/state/soo/spool"),
    ],
)
def test_the_first_that_is_set_is_taken(given: dict[str, str], wanted: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("STATE_DIRECTORY", "XDG_STATE_HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    assert state_folder("spool") == Path(wanted)
