"""The page of the command line names every command and every option, with the words of the code."""

import re
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from service.cli.app import app

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs/reference/command-line.md").read_text()
GROUP = typer.main.get_command(app)
assert isinstance(GROUP, typer.core.TyperGroup)


def commands(group, prefix=""):
    """Return every command by its words; a group of commands stands for those in it."""
    found = {}
    for name, command in group.commands.items():
        is_group = isinstance(command, typer.core.TyperGroup)
        if not is_group or command.invoke_without_command:
            found[prefix + name] = command
        if is_group:
            found |= commands(command, f"{prefix}{name} ")
    return found


COMMANDS = commands(GROUP)


def test_the_list_of_commands_says_what_each_says_itself() -> None:
    group = CliRunner().invoke(app, ["--help"], terminal_width=300)
    listed = dict(re.findall(r"^  ([a-z-]+)  +(\S.*)$", group.output.partition("Commands:")[2], re.MULTILINE))
    assert listed == {
        name: (command.help or "").split("\n\n")[0].replace("\n", " ") for name, command in GROUP.commands.items()
    }


def sections() -> dict[str, str]:
    """Return the text of each command's section."""
    return dict(re.findall(r"^## soo ([\w -]+)\n(.*?)(?=^## |\Z)", PAGE, re.DOTALL | re.MULTILINE))


def test_every_command_has_a_section() -> None:
    assert list(sections()) == list(COMMANDS)


@pytest.mark.parametrize("name", list(COMMANDS))
def test_options_of_a_command_are_those_of_the_code(name: str) -> None:
    rows = re.findall(r"^\| `((?:--)?[\w-]+)` \| ([^|]*) \| (.*) \|$", sections()[name], re.MULTILINE)
    wanted = [(option.opts[0], option.help) for option in COMMANDS[name].params]
    assert [(option, meaning) for option, _, meaning in rows] == wanted
    required = {option.opts[0] for option in COMMANDS[name].params if option.required}
    assert {option for option, default, _ in rows if default == "required"} == required
