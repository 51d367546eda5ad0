"""What the demonstration prints of its service: where its key is, never the key; commands stay in one line."""

import io
from pathlib import Path
from types import SimpleNamespace

import pytest
from rich.console import Console

from service.cli.demonstration.demo_screen import Presenter
from service.cli.demonstration.invitation import commands_to_try, program
from service.cli.demonstration.persons import Person

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
    commands = [line for line in lines if line.startswith(("SOO_URL=", program()))]
    key = f"SOO_URL=http://127.0.0.1:1 SOO_KEY_FILE={key_file} {program()}"
    assert commands == [
        f"{key} watch",
        f"{program()} demo inject rain" if is_flown else f"{key} status",
        f"{key} control stop",
    ]
    assert "soo_secret" not in printed.getvalue()


def test_two_persons_get_their_commands_with_their_own_keys():
    persons = Person("Anna", "operator", Path("a key/o")), Person("Boris", "approver", Path("a key/b"))
    tries = dict(commands_to_try("http://127.0.0.1:1", Path("k"), persons, is_flown=True))
    anna = "SOO_URL=http://127.0.0.1:1 SOO_KEY_FILE='a key/o'"
    assert tries["Anna prepares a torque"] == f"{anna} {program()} torque prepare 'a first one'"
    confirm = f"{anna} SOO_SECOND_KEY_FILE='a key/b' {program()} torque confirm 1"
    assert tries["Boris confirms it by its digest"] == confirm


def test_the_program_is_named_by_a_path_that_another_terminal_can_run(monkeypatch, tmp_path):
    monkeypatch.setattr("sys.executable", str(tmp_path / "a venv" / "python"))
    assert program() == f"'{tmp_path}/a venv/python' -m service"
    (tmp_path / "a venv").mkdir()
    (tmp_path / "a venv" / "soo").touch()
    assert program() == f"'{tmp_path}/a venv/soo'"


def test_no_bar_stays_above_the_operation(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")  # a dumb terminal erases nothing
    printed = io.StringIO()
    presenter = Presenter(Console(file=printed, width=80, force_terminal=True), 0.0, with_table=True)
    presenter.open()
    presenter.close()
    # a transient bar is erased at its end
    assert printed.getvalue().rstrip().endswith("\x1b[2K")
