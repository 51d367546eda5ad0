"""Files as other programs write them: powers of carriers over some days, in the forms that operators have."""

import csv
import io
import math
import random
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from zoneinfo import ZoneInfo


@dataclass(frozen=True)
class Truth:
    """True levels: one row an epoch, dBm."""

    epochs: Sequence[datetime]
    carriers: Sequence[str]
    levels_dbm: Sequence[Sequence[float]]


def truth(
    carriers: Sequence[str],
    rows: int,
    first: datetime = datetime(2026, 3, 1, tzinfo=UTC),
    step_s: float = 60.0,
    seed: int = 1,
) -> Truth:
    """Return levels with a daily change and noise, in thousandths."""
    draw = random.Random(seed)
    epochs = [first + timedelta(seconds=step_s * k) for k in range(rows)]
    levels = [
        [
            round(-60.0 - 2.0 * n + 0.5 * math.sin(2 * math.pi * k * step_s / 86164.0 + n) + draw.gauss(0.0, 0.1), 3)
            for n in range(len(carriers))
        ]
        for k in range(rows)
    ]
    return Truth(epochs, list(carriers), levels)


@dataclass(frozen=True)
class Writing:
    """Manner in which a program writes a table."""

    separator: str = ","
    decimal: str = "."
    pattern: str = "%Y-%m-%d %H:%M:%S"
    zone: str = "UTC"
    offset_db: float = 0.0
    time_name: str = "Time"
    names: dict[str, str] | None = None
    is_long: bool = False
    end: str = "\n"
    mark: bytes = b""


def epoch_text(epoch: datetime, writing: Writing) -> str:
    """Return an epoch as a program writes it."""
    local = epoch.astimezone(ZoneInfo(writing.zone))
    return (
        local.strftime(writing.pattern)
        if "%" in writing.pattern
        else str(int(epoch.timestamp() * float(writing.pattern)))
    )


def table(known: Truth, writing: Writing) -> list[list[str]]:
    """Return header and rows as texts."""
    names = [(writing.names or {}).get(each, each) for each in known.carriers]

    def level(dbm: float) -> str:
        return f"{dbm - writing.offset_db:.3f}".replace(".", writing.decimal)

    if writing.is_long:
        rows = [
            [epoch_text(epoch, writing), name, level(dbm)]
            for epoch, levels in zip(known.epochs, known.levels_dbm, strict=True)
            for name, dbm in zip(names, levels, strict=True)
        ]
        return [[writing.time_name, "Channel", "Power"], *rows]
    return [
        [writing.time_name, *names],
        *(
            [epoch_text(epoch, writing), *map(level, levels)]
            for epoch, levels in zip(known.epochs, known.levels_dbm, strict=True)
        ),
    ]


def write_table(path: Path, rows: Sequence[Sequence[str]], writing: Writing) -> Path:
    """Write rows as a file."""
    text = io.StringIO()
    csv.writer(text, delimiter=writing.separator, lineterminator=writing.end).writerows(rows)
    path.write_bytes(writing.mark + text.getvalue().encode())
    return path
