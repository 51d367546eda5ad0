"""State of sending an archive, kept in a small file beside it, and the refused rows.

Law of this file: the state is replaced as a whole and written through after every answer of the service; it belongs to
one content of the file (SHA-256) and one destination. What stands in the file of refused rows beyond what the state
knows is cut off when the sending goes on.
"""

import csv
import hashlib
import io
import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from service.frontend.backfill.columns import ArchiveError
from service.records.csv_guard import guarded

_FORMAT = 1


@dataclass(slots=True)
class SendCounters:
    """Counters of the rows of a file, over all runs."""

    #: rows of the file that are settled, with any outcome
    rows: int = 0
    accepted: int = 0
    duplicates: int = 0
    late: int = 0
    #: refused by the service by name
    refused: int = 0
    #: rows whose cells mean nothing; never sent
    unreadable: int = 0
    #: rows of other sources; never sent
    other_sources: dict[str, int] = field(default_factory=dict)

    @property
    def kept_back(self) -> int:
        """Rows in the file of refused rows."""
        return self.refused + self.unreadable


@dataclass(frozen=True, slots=True)
class Destination:
    """Destination of a file: service, spacecraft, source and chosen rows."""

    sha256: str
    service: str
    spacecraft_id: str
    source: str
    from_source: str
    #: stated layout of a foreign file; empty for our own
    layout: str = ""

    @property
    def key(self) -> str:
        """Sixteen hexadecimal digits that stand for all of it."""
        return hashlib.sha256(json.dumps(asdict(self), sort_keys=True).encode()).hexdigest()[:16]


class SendState:
    """State of one sending.

    Parameters
    ----------
    path : Path
        The archive.
    destination : Destination
        Where it goes.
    folder : Path, optional
        Where the state and the refused rows are kept; default: beside the archive.
    """

    def __init__(self, path: Path, destination: Destination, folder: Path | None = None) -> None:
        position = folder or path.parent
        self.path = position / f"{path.name}.{destination.key}.send.json"
        self.refused_path = position / f"{path.name}.refused.csv"
        self.counters = SendCounters()
        self.is_complete = False
        #: under which the rows go; None before the first
        self.plan_id: int | None = None
        self._destination = destination
        self._refused_bytes = 0

    def load(self) -> bool:
        """Read what an earlier run left; False when there is nothing."""
        try:
            said: dict[str, Any] = json.loads(self.path.read_text())
        except FileNotFoundError:
            return False
        except (OSError, ValueError) as error:
            raise ArchiveError(f"{self.path} cannot be read: {error}; remove it to begin again") from error
        if said.get("format") != _FORMAT or said.get("destination") != asdict(self._destination):
            raise ArchiveError(f"{self.path} belongs to another upload; remove it to begin again")
        names = {each.name for each in fields(SendCounters)}
        self.counters = SendCounters(**{name: value for name, value in said["counters"].items() if name in names})
        self.is_complete = bool(said["is_complete"])
        self.plan_id = said.get("plan_id")
        self._refused_bytes = int(said["refused_bytes"])
        return True

    def begin(self) -> None:
        """Make the places ready; what was refused beyond the state's knowledge is cut off."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        if self.refused_path.exists():
            if self._refused_bytes:
                os.truncate(self.refused_path, self._refused_bytes)
            else:
                self.refused_path.unlink()

    def refuse(self, header: Sequence[str], rows: Sequence[tuple[int, str, str, Sequence[Any]]]) -> None:
        """Write rows (line, code, words, cells) to the file of refused rows."""
        if not rows:
            return
        text = io.StringIO()
        writer = csv.writer(text)
        if not self._refused_bytes:
            writer.writerow(("line", "code", "detail", *map(guarded, header)))
        writer.writerows((line, code, detail, *map(_cell, cells)) for line, code, detail, cells in rows)
        with self.refused_path.open("ab") as file:
            file.write(text.getvalue().encode())
            file.flush()
            os.fsync(file.fileno())
            self._refused_bytes = file.tell()

    def save(self) -> None:
        """Write the state through to the disk, in place of the one before."""
        document = {
            "format": _FORMAT,
            "destination": asdict(self._destination),
            "counters": asdict(self.counters),
            "refused_bytes": self._refused_bytes,
            "is_complete": self.is_complete,
            "plan_id": self.plan_id,
        }
        others = self.path.with_name(self.path.name + ".new")
        with others.open("w") as file:
            json.dump(document, file)
            file.flush()
            os.fsync(file.fileno())
        others.replace(self.path)


def _cell(value: Any) -> Any:
    """Return a cell as it is written: a number as it is, a text that a spreadsheet would compute guarded."""
    try:
        float(value)
    except (TypeError, ValueError):
        return guarded(value) if isinstance(value, str) else value
    return value
