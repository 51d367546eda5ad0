"""Manifest of a backup: what it must hold, so that a copy can be judged without the archive it was made of."""

import json
from dataclasses import asdict, dataclass, field


class BackupError(Exception):
    """A backup cannot be made, trusted or restored; the text gives the reason and the remedy."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SpacecraftCount:
    """Row counts and positions of one spacecraft in a backup."""

    newest_number: int
    consumed_number: int
    newest_epoch_us: int | None
    result_sequence: int
    #: rows of each table that names a spacecraft
    rows: dict[str, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class Manifest:
    """Manifest of a backup: origin, file, hash and row counts."""

    made_at_us: int
    #: `sqlite` or `postgresql`
    made_from: str
    #: layout of the archive, and of this manifest
    layout: int
    #: name of the file beside the manifest
    file: str
    size_bytes: int
    sha256: str
    #: rows of each table
    tables: dict[str, int]
    spacecraft: dict[str, SpacecraftCount]
    #: damaged rows when the backup was made, in words, table by table
    damaged: list[str] = field(default_factory=list)

    def as_text(self) -> str:
        """Return the manifest as JSON."""
        return json.dumps(asdict(self), indent=2, sort_keys=True) + "\n"
