"""Dialogue of `soo import` and `soo put` with people and programs: roles of files, exit codes, terminal, signals."""

import json
import sys
from enum import StrEnum
from typing import Any, NoReturn

import typer

#: the service holds something else, which was not changed, or rows were refused
EXIT_DIFFERENT = 3
EXIT_STOPPED = 1


class FileRole(StrEnum):
    """Role of a file."""

    SPACECRAFT = "spacecraft"
    CARRIERS = "carriers"
    EPHEMERIS = "ephemeris"
    REFERENCES = "references"
    POWERS = "powers"


def is_terminal() -> bool:
    """Return whether a person can be asked."""
    return sys.stdin.isatty() and sys.stderr.isatty()


def printable(text: str) -> str:
    """Return a text that the terminal's encoding can hold."""
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    return text.encode(encoding, "backslashreplace").decode(encoding)


def shown(value: Any) -> str:
    """Return a value for people, in words that a statement takes."""
    if isinstance(value, dict):
        # names may hold commas and colons
        return json.dumps(value, ensure_ascii=False)
    return " + ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)


def answer(question: str, default: Any) -> Any:
    """Return what a person states on a terminal, as a manifest would."""
    from service.cli.importing.manifest import read_statement

    likely = None if default is None else shown(default)
    return read_statement(str(typer.prompt(printable(question), default=likely, err=True)).strip())


def stop(*_: object) -> NoReturn:
    """Let a signal end the command as Ctrl-C does."""
    raise KeyboardInterrupt
