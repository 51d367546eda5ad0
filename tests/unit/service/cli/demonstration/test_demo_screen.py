"""What the demonstration prints of its service: where its key is, never the key; commands stay in one line."""

import io
from types import SimpleNamespace

import pytest
from rich.console import Console

from service.cli.demonstration.demo_screen import Presenter

SCENE = SimpleNamespace(
    phase="start",
    until="",
    client=SimpleNamespace(service_url="http://127.0.0.1:1"),
    story=SimpleNamespace(spacecraft_id="sim", phases={}),
)


@pytest.mark.parametrize("width", [20, 80, 400])
@pytest.mark.parametrize("is_flown", [True, False])
def test_the_key_is_named_by_its_file_and_commands_are_not_broken(tmp_path, width, is_flown):
    SCENE.story.centre = object() if is_flown else None
    printed = io.StringIO()
    presenter = Presenter(Console(file=printed, width=width), 0.0, with_table=True)
    key_file = tmp_path / "administrator.key"
    key_file.write_text("soo_secret")
    presenter.announce("http://127.0.0.1:1", key_file)
    assert printed.getvalue() == "", "there is no spacecraft yet"
    presenter.show(SCENE)
    presenter._invite(SCENE)
    lines = printed.getvalue().splitlines()
    assert f"console http://127.0.0.1:1/console/, sign in with the key in {key_file}" in lines
    header = f'-H "Authorization: Bearer $(cat {key_file})"'
    base = "http://127.0.0.1:1/api/v1/spacecraft/sim"
    commands = [line for line in lines if line.startswith(("curl ", "soo "))]
    assert commands == [
        f"curl {header} {base}/attitude",
        "soo demo inject rain" if is_flown else f"curl {header} {base}/control",
        f"curl {header} -X POST {base}/control:stop",
    ]
    assert "soo_secret" not in printed.getvalue()
