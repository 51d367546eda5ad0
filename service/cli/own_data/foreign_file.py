"""Foreign files of powers: their layout stated by options, proven by content, or asked for on a terminal."""

import json
import shlex
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from service.cli.command_group import end
from service.cli.own_data.foreign_archive import ForeignArchive, sample_of
from service.formats.foreign.layout import ForeignTableError, StatedLayout, TableLayout, unit_in_name
from service.formats.foreign.proposal import PLAUSIBLE_DBM, Proposal, Question, Sample, propose
from service.formats.foreign.text_table import MIXED
from service.frontend.backfill.columns import ArchiveError
from service.frontend.backfill.reader import open_archive
from service.records.epoch import US_PER_S, format_epoch, parse_epoch

if TYPE_CHECKING:
    from service.client.service_client import ServiceClient
    from service.frontend.backfill.backfill import ArchiveOrder

#: formats that only this project's own archives have
_OWN_SUFFIXES = frozenset({".tdm", ".ndjson", ".jsonl"})
#: epochs ahead of this machine's clock by less are a difference of clocks
_FUTURE_US = 60 * US_PER_S
_WORDS_OF_CHOICE = {"--unit": "dBm|dBW", "--map": "NAME=CARRIER"}


def stated_pairs(pairs: list[str], option: str, form: str) -> dict[str, str]:
    """Return values by name from ``NAME=VALUE``, or end; a name may hold equals signs."""
    split = {pair: pair.rpartition("=") for pair in pairs}
    wrong = [pair for pair, (name, _, value) in split.items() if not name.strip() or not value.strip()]
    if wrong:
        end(f"{option} {wrong[0]!r}: write {form}")
    names = [name.strip() for name, _, _ in split.values()]
    if len(set(names)) < len(names):
        end(f"{option} names one thing twice; state each once")
    return {name.strip(): value.strip() for name, _, value in split.values()}


def with_layout(
    client: "ServiceClient", order: "ArchiveOrder", stated: StatedLayout, *, can_ask: bool
) -> "ArchiveOrder":
    """Return an order with the layout of its file; a file of our own format comes back unchanged.

    Raises
    ------
    ArchiveError
        The file is no table, or contradicts what was stated.
    """
    if is_own(order.path, stated):
        return order
    try:
        layout = _layout_of(client, order, stated, can_ask=can_ask)
    except ForeignTableError as error:
        raise ArchiveError(f"{order.path}: {error}") from error
    return laid_out(order, layout)


def laid_out(order: "ArchiveOrder", layout: TableLayout) -> "ArchiveOrder":
    """Return an order whose file is read under a layout."""
    return replace(order, layout=json.dumps(layout.as_document()), open_file=partial(_open_foreign, layout=layout))


def carrier_names(plan: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Return the ids of a plan's carriers by id and by name."""
    known = {str(each["name"]): str(each["id"]) for each in plan if each.get("name")}
    return known | {str(each["id"]): str(each["id"]) for each in plan}


def is_own(path: Path, stated: StatedLayout) -> bool:
    """Return whether a file has this project's columns and no other layout was stated."""
    if path.suffix.lower() in _OWN_SUFFIXES:
        if not stated.is_empty:
            end(f"{path.name}: columns and zones are stated for CSV and Parquet only")
        return True
    if not stated.is_empty:
        return False
    try:
        with closing(open_archive(path)) as archive:
            header = [name.strip() for name in archive.header]
    except ArchiveError:
        # the foreign reader says more about what is wrong
        return False
    return "epoch" in header and any(name.endswith(("_dbm", "_dbw")) for name in header)


def impossibility(survey: Mapping[str, Any], now_us: int | None) -> str | None:
    """Return why a surveyed foreign file must not be sent; None: it may.

    Parameters
    ----------
    survey : mapping
        Report of `service.frontend.backfill.backfill.check_archive`.
    now_us : int or None
        Present, microseconds UTC; None: epochs of a simulated spacecraft may lie in the future.
    """
    mixed = sum(fault["rows"] for fault in survey["faults"] if fault["kind"] == MIXED)
    if mixed:
        return f"mixed separators: {mixed} rows have another separator than the header; write one separator"
    if not survey["rows"]:
        first = f"; {_grouped(survey['faults'][0])}" if survey["faults"] else ""
        return f"no row can be read{first}"
    if now_us is not None and parse_epoch(survey["stop"]) > now_us + _FUTURE_US:
        ahead_h = (parse_epoch(survey["stop"]) - now_us) / US_PER_S / 3600
        present = format_epoch(now_us)
        return f"the newest epoch {survey['stop']} lies {ahead_h:.2f} h after now ({present}); is --tz right?"
    mean_dbm = survey["mean_dbm"]
    if mean_dbm is not None and not PLAUSIBLE_DBM[0] < mean_dbm < PLAUSIBLE_DBM[1]:
        return f"the mean level is {mean_dbm:.1f} dBm, which no analyzer shows for a carrier; is --unit right?"
    return None


def _grouped(fault: Mapping[str, Any]) -> str:
    """Return a group of faults as a line."""
    return f"{fault['rows']} rows: {fault['kind']} (first: line {fault['line']}, {fault['detail']})"


def _open_foreign(path: Path, layout: TableLayout) -> ForeignArchive:
    """Return a foreign file under a layout."""
    return ForeignArchive(path, layout)


def _layout_of(client: "ServiceClient", order: "ArchiveOrder", stated: StatedLayout, *, can_ask: bool) -> TableLayout:
    """Return the layout of a file, asked for where it is not stated or proven; without a terminal, end."""
    carriers = carrier_names(client.carriers(order.spacecraft_id)["carriers"])
    sample = sample_of(order.path)
    is_asked = False
    while (proposal := propose(sample, stated, carriers)).layout is None:
        if not can_ask:
            end(_statement(order, stated, proposal))
        is_asked = True
        stated = _answered(sample, stated, proposal.questions[0], carriers)
    if can_ask and (is_asked or proposal.found != stated):
        _confirm(order, stated, proposal.found, proposal.layout)
    return proposal.layout


def _statement(order: "ArchiveOrder", stated: StatedLayout, proposal: Proposal) -> str:
    """Return the questions of a file, and the command that answers them."""
    lines = [f"{order.path}: this must be stated, it is not guessed:"]
    options = _command(order, stated, proposal.found)
    for option, text, choices, default in proposal.questions:
        shown = f" [{', '.join(choices[:20])}]" if choices else ""
        lines.append(f"  {option}: {text}{shown}" + (f"; likely {default}" if default else ""))
        options += f" {option} {shlex.quote(_WORDS_OF_CHOICE.get(option, option.removeprefix('--').upper()))}"
    return "\n".join((*lines, "State it:", f"  {options}"))


def _command(order: "ArchiveOrder", stated: StatedLayout, found: StatedLayout) -> str:
    """Return the command with everything that is known of a file."""
    words = ["soo", "send", str(order.path), "--spacecraft", order.spacecraft_id, "--source", order.source]
    return shlex.join([*words, *found.options(stated.carriers)])


def _answered(sample: Sample, stated: StatedLayout, question: Question, carriers: Mapping[str, str]) -> StatedLayout:
    """Return the layout with the answer of a person; an answer that the table contradicts is asked for again."""
    while True:
        try:
            answered = _stated_answer(stated, question)
            propose(sample, answered, carriers)
        except ForeignTableError as error:
            typer.echo(str(error), err=True)
        else:
            return answered


def _stated_answer(stated: StatedLayout, question: Question) -> StatedLayout:
    """Ask one question."""
    if question.option == "--map":
        typer.echo(question.text, err=True)
        given = {
            name: typer.prompt(f"carrier of {name!r} (empty = left out)", default="", show_default=False, err=True)
            for name in question.choices
        }
        return replace(stated, carriers={name: carrier.strip() for name, carrier in given.items() if carrier.strip()})
    for number, choice in enumerate(question.choices, start=1):
        typer.echo(f"  {number}  {choice}", err=True)
    answer = str(typer.prompt(f"{question.option}: {question.text}", default=question.default, err=True)).strip()
    if answer.isdecimal() and 0 < int(answer) <= len(question.choices):
        answer = question.choices[int(answer) - 1]
    if question.option == "--unit" and answer not in question.choices:
        raise ForeignTableError(f"{answer!r} is no unit; write {' or '.join(question.choices)}")
    if question.option == "--time-column":
        return replace(stated, time_columns=tuple(answer.split(" + ")))
    named: dict[str, Any] = {question.option.removeprefix("--").replace("-", "_"): answer}
    return replace(stated, **named)


def _confirm(order: "ArchiveOrder", stated: StatedLayout, found: StatedLayout, layout: TableLayout) -> None:
    """Show a layout and the command that states it; end unless a person agrees."""
    for name, value in layout.as_document().items():
        typer.echo(f"  {name:12} {value}", err=True)
    silent = replace(found, unit=None) if all(unit_in_name(name) for name in layout.units) else found
    typer.echo(f"without questions: {_command(order, stated, silent)}", err=True)
    if not typer.confirm("read the file so?", err=True):
        end("nothing was sent")
