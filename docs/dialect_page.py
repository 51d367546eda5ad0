"""Reference page of the dialects, made from their tables by ``python -m docs.dialect_page``."""

import sys
import textwrap
from collections.abc import Callable, Iterable

from analyzer_sim.dialects.dialect import Command, Dialect
from analyzer_sim.dialects.dialects import DIALECTS
from analyzer_sim.dialects.sweep_rows import CLOCK_ROWS, COMMON_COMMANDS, SYSTEM_COMMANDS
from analyzer_sim.instrument.instrument_settings import AnalyzerModel, FilterSteps, Limits
from analyzer_sim.scpi.parameters import Boolean, Choice, Level, Numeric, Parameter, Quoted, TraceName

#: what keeps the page current
MARKDOWN_COMMAND = "python -m docs.dialect_page"
_SHARED_ROWS = (*COMMON_COMMANDS, *SYSTEM_COMMANDS, *CLOCK_ROWS)
#: parameters of a row that are written out; a list of more of one kind is shortened
_MOST_PARAMETERS = 4
_WIDTH = 118

_HEAD = f"""# Dialects of the simulated analyzer

Made by `{MARKDOWN_COMMAND}` from the tables the simulator runs on; a test keeps it current.

`soo-analyzer serve --dialect NAME` speaks one of four. Each row of the tables below is one header: upper case letters
are its short form, brackets mark what may be left out, `|` alternatives, `<n>` the largest numeric suffix. Numeric
settings take `MIN MAX DEF` and answer to `? MIN` and the like, those of frequency, filters, sweep and level `UP DOWN`
too; numbers are answered without a unit; a setting out of range is stored at its limit and reported as -222.

Proofs: `tests/unit/analyzer_sim/test_dialect_table.py` sets and reads back every function in every dialect,
`test_<name>.py` beside it what is peculiar to one, `tests/conformance` the rules of syntax and protocol in each;
`make clients` runs third-party drivers against it.

## What differs
"""

_DEVIATIONS = """
## Where it differs from real instruments, on purpose

Of every dialect:

- The resolution filter is Gaussian; its steps are those of the maker.
- One trace exists; the others are blank. `VIEW` and `BLANk` are not modes of it.
- A reference level without a unit is in dBm whatever the unit of the trace.
- Averages and counts end at 1000 sweeps.
- The sweep type AUTO sweeps; an FFT is taken when it is asked for.
- The quasi-peak detector reads the positive peak, the auto-peak and normal detectors read the highest of a point.
- The trigger is free running.
- Of the measurement functions the channel power is there. Headers of markers, adjacent channels, occupied bandwidth,
  lists of measurements and automatic tuning are unknown: -113.
- `SYSTem:DATE?`, `TIME?` tell the time of the world; `SIMulation:EPOCh?` is the simulator's own.
"""


def _limits(limits: Limits, unit: str) -> str:
    return f"{limits.low:g} to {limits.high:g}{unit}, {limits.default:g} after a reset"


def _steps(steps: FilterSteps) -> str:
    rule = "nearest, half way up" if steps.is_linear else "nearest by ratio"
    return f"{len(steps.steps_hz)} steps {steps.steps_hz[0]:g} Hz to {1e-6 * steps.steps_hz[-1]:g} MHz, {rule}"


def _points(model: AnalyzerModel) -> str:
    if model.are_points_fixed:
        return f"{model.points.default:g}, whatever is asked"
    return _limits(model.points, "")


def _on_off(*, is_on: bool) -> str:
    return "on" if is_on else "off"


def _ascii_trace(dialect: Dialect) -> str:
    style = dialect.traces
    text = "numbers, comma separated" + (", one comma more at the end" if style.ascii_end else "")
    return f"{text}, in a block of definite length" if style.is_ascii_in_block else text


#: line of the table of differences -> its entry for a dialect
_DIFFERENCES: tuple[tuple[str, Callable[[Dialect], str]], ...] = (
    ("`*IDN?`", lambda d: f"`{d.identity}`"),
    ("highest frequency", lambda d: f"{1e-9 * d.model.max_frequency_hz:g} GHz"),
    ("least span", lambda d: f"{d.model.min_span_hz:g} Hz, and zero"),
    ("resolution filter", lambda d: _steps(d.model.rbw)),
    ("video filter", lambda d: _steps(d.model.vbw)),
    ("couplings", lambda d: f"span/RBW {d.model.span_per_rbw:g}, VBW/RBW {d.model.vbw_per_rbw:g}"),
    ("points", lambda d: _points(d.model)),
    ("sweep time", lambda d: f"{d.model.sweep_time_s.low:g} to {d.model.sweep_time_s.high:g} s, automatic"),
    ("reference level", lambda d: _limits(d.model.reference_dbm, " dBm")),
    ("level offset", lambda d: _limits(d.model.level_offset_db, " dB")),
    (
        "attenuation",
        lambda d: (
            f"{d.model.attenuation_db.low:g} to {d.model.attenuation_db.high:g} dB in steps of "
            f"{d.model.attenuation_step_db:g}, automatic in steps of {d.model.attenuation_coupled_step_db:g}"
        ),
    ),
    ("averages", lambda d: _limits(d.model.average_count, "")),
    ("detector after a reset", lambda d: {"APE": "auto or normal peak", "POS": "positive peak"}[d.model.detector]),
    ("`INIT:CONT` after `*RST`", lambda d: _on_off(is_on=d.model.is_continuous_after_reset)),
    ("`INIT:CONT` after `SYST:PRES`", lambda d: _on_off(is_on=d.model.is_continuous_after_preset)),
    ("formats (`FORMat?`)", lambda d: " ".join(f"`{row.answer}`" for row in d.traces.formats)),
    ("blocks after a reset", lambda d: "big-endian" if d.model.is_big_endian else "little-endian"),
    ("byte order", lambda d: "`FORM:BORD`" if any("BORDer" in r.pattern for r in d.commands) else "fixed: -113"),
    ("ASCII trace", _ascii_trace),
    ("no valid trace", lambda d: f"`{d.traces.invalid.decode()}`" if d.traces.invalid else "no answer, -230"),
    ("units (no dBW)", lambda d: " ".join(d.units)),
    ("empty error queue", lambda d: f"`{d.model.no_error}`"),
    ("error queue", lambda d: f"{d.model.error_queue_depth}, " + _queue_owner(d.model)),
    ("noise of its own", lambda d: f"{d.own_noise_dbm_hz:g} dBm/Hz at 0 dB attenuation"),
    ("interface messages", lambda d: " ".join(sorted(f"`{m.decode()}`" for m in d.interface_messages)) or "-"),
)


def _queue_owner(model: AnalyzerModel) -> str:
    return "one a session" if model.is_error_queue_per_session else "shared by all sessions"


def _parameter_text(parameter: Parameter) -> str:
    """Return how a parameter is written."""
    if isinstance(parameter, Numeric):
        return f"number [{'|'.join(parameter.units)}]" if parameter.units else "number"
    if isinstance(parameter, Choice):
        return "|".join(parameter.words)
    if isinstance(parameter, TraceName):
        words = "|".join(f"{prefix}1..{parameter.highest}" for prefix in parameter.prefixes)
        return f"1..{parameter.highest}|{words}" if parameter.is_number_legal else words
    texts: dict[type, str] = {Level: "level [unit]", Boolean: "ON|OFF|1|0", Quoted: "name"}
    return texts.get(type(parameter), "field")


def _parameters(parameters: tuple[Parameter, ...], optional: int) -> str:
    texts = [_parameter_text(parameter) for parameter in parameters[:_MOST_PARAMETERS]]
    required = len(parameters) - optional
    shown = [text if number < required else f"({text})" for number, text in enumerate(texts)]
    return ", ".join(shown) + (", ..." if len(parameters) > _MOST_PARAMETERS else "")


def _code(text: str) -> str:
    return "`" + text.replace("|", "\\|") + "`"


def _line(row: Command) -> str:
    """Return the line of a row: header, command, query, remark."""
    command = (
        "-" if row.write is None else _code(_parameters(row.parameters, row.optional) or " ").replace("` `", "yes")
    )
    asked = row.query_parameters[: row.query_required]
    query = "-" if row.query is None else (_code(_parameters(asked, 0)) if asked else "yes")
    notes = (
        (row.query_starts is not None, "the query sweeps first"),
        (row.query_waits or row.write_waits, "waits for the sweep"),
        (row.is_inert, "changes nothing"),
    )
    return f"| {_code(row.pattern)} | {command} | {query} | {', '.join(text for holds, text in notes if holds)} |"


def _table(rows: Iterable[Command]) -> list[str]:
    return ["", "| header | command | query | |", "|---|---|---|---|", *(_line(row) for row in rows)]


def _item(sentence: str) -> str:
    return textwrap.fill(sentence, _WIDTH, initial_indent="- ", subsequent_indent="  ", break_on_hyphens=False)


def _own_rows(dialect: Dialect) -> list[Command]:
    """Return the rows of a dialect that not all have."""
    shared = {id(row) for row in _SHARED_ROWS}
    return [row for row in dialect.commands if id(row) not in shared]


def markdown_page() -> str:
    """Return the reference page of the dialects."""
    dialects = tuple(DIALECTS.values())
    lines = [_HEAD, "| | " + " | ".join(f"`{d.name}`" for d in dialects) + " |", "|---" * (len(dialects) + 1) + "|"]
    lines += [f"| {name} | " + " | ".join(entry(d) for d in dialects) + " |" for name, entry in _DIFFERENCES]
    lines.append(_DEVIATIONS)
    for dialect in dialects:
        lines += [f"Of `{dialect.name}`:", "", *(_item(sentence) for sentence in dialect.deviations), ""]
    lines += ["## Headers of every dialect", *_table(_SHARED_ROWS)]
    for dialect in dialects:
        lines += ["", f"## Headers of `{dialect.name}`", *_table(_own_rows(dialect))]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.stdout.write(markdown_page())
