"""Dialogue of `soo import` and `soo put` with people and programs: roles of files, exit codes, terminal, signals."""

import sys
from enum import StrEnum
from typing import NoReturn

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


def stop(*_: object) -> NoReturn:
    """Let a signal end the command as Ctrl-C does."""
    raise KeyboardInterrupt
