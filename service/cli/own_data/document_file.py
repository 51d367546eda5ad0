"""Files of the catalogue: read, decoded as the interface does, and shown as a table of what was understood."""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import typer

from service.cli.command_group import end

if TYPE_CHECKING:
    from pydantic import BaseModel, TypeAdapter

    from service.errors import FieldError

M = TypeVar("M", bound="BaseModel")
#: exit code where the service holds something else, which was not changed
EXIT_DIFFERENT = 3
#: no document of the catalogue is larger, bytes
_MAX_BYTES = 64 << 20


def read_bytes(path: Path) -> bytes:
    """Return the content of a file, or end."""
    try:
        if path.stat().st_size > _MAX_BYTES:
            end(f"{path} is larger than {_MAX_BYTES >> 20} MiB; this is no document of the catalogue")
        return path.read_bytes()
    except OSError as error:
        end(f"{path} cannot be read: {error.strerror}", cause=error)


def read_text(path: Path) -> str:
    """Return the text of a file, or end."""
    try:
        return read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        end(f"{path} is not UTF-8; save it as UTF-8", cause=error)


def decoded(path: Path, adapter: "TypeAdapter[M]", raw: bytes) -> M:
    """Return a validated document, or end with every field at fault."""
    # web framework and validation cost a quarter of a second that other commands need not pay
    from service.api.problems.problems import RequestProblemError
    from service.api.protocol.requests import decode

    try:
        return decode(adapter, raw)
    except RequestProblemError as error:
        faults = [f"{field.pointer or '/'}: {field.detail}" for field in error.fields] or [error.detail]
        if any(field.pointer.endswith("/latitude_deg") and field.code == "value.range" for field in error.fields):
            faults.append("latitude and longitude look exchanged: no latitude is beyond 90 deg")
        end(
            "\n".join((f"{path} is refused:", *(f"  {fault}" for fault in faults), *_next_steps(error.code))),
            cause=error,
        )


def refuse_findings(path: Path, faults: Sequence["FieldError"]) -> None:
    """End with what contradicts physics or the catalogue, if anything does."""
    if faults:
        lines = (f"  {fault.pointer}: {fault.detail}" for fault in faults)
        end("\n".join((f"{path} is refused:", *lines, *_next_steps(*(fault.code for fault in faults)))))


def _next_steps(*codes: str) -> list[str]:
    """Return what to do next, a line for each code."""
    from service.api.problems.next_steps import NEXT_STEPS

    return [f"Next: {NEXT_STEPS[code]}" for code in dict.fromkeys(codes)]


def show(title: str, rows: Iterable[tuple[str, ...]], *, columns: Sequence[str] = ("", "")) -> None:
    """Print a table for people."""
    from rich.console import Console
    from rich.table import Table

    table = Table(*columns, title=title, title_justify="left", show_header=any(columns))
    for row in rows:
        table.add_row(*row)
    Console().print(table)


def report(document: Mapping[str, Any], *, as_json: bool, sentence: str) -> None:
    """Print the outcome: JSON for programs, a sentence for people."""
    typer.echo(json.dumps(document) if as_json else sentence)
