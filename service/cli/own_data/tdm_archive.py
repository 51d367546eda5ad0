"""A Tracking Data Message as an archive to send: carrier powers of all segments, put together into rows by epoch."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from service.errors import InvalidInputError
from service.formats.foreign.layout import ForeignTableError
from service.formats.foreign.messages import message_text
from service.formats.tdm import read_tdm
from service.frontend.backfill.columns import ArchiveError
from service.frontend.backfill.reader import ArchiveFileReader, FileRow, open_archive


def open_any_archive(path: Path) -> ArchiveFileReader:
    """Return a file by the ending of its name, messages too; ArchiveError when it cannot be read as that."""
    return TdmArchive(path) if path.suffix.lower() == ".tdm" else open_archive(path)


class TdmArchive:
    """A message whose TRACK_ID is ``source/carrier``, as this service writes it; the whole of it is held in memory.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    ArchiveError
        No such message, or a segment without source and carrier.
    """

    def __init__(self, path: Path) -> None:
        try:
            tracks = read_tdm(message_text(path.read_text("utf-8-sig")))
        except OSError as error:
            raise ArchiveError(f"{path}: {error.strerror or error}") from error
        except (UnicodeDecodeError, ForeignTableError, InvalidInputError) as error:
            raise ArchiveError(f"{path} cannot be read: {error}") from error
        powers: dict[tuple[int, str], dict[str, float]] = {}
        names: dict[str, None] = {}
        for track in tracks:
            source, _, carrier = track.track_id.rpartition("/")
            if not source or not carrier:
                raise ArchiveError(f"TRACK_ID = {track.track_id or 'nothing'}; wanted as source/carrier")
            names[carrier] = None
            for epoch_us, power_dbm in zip(track.epochs_us.tolist(), track.power_dbm.tolist(), strict=True):
                powers.setdefault((epoch_us, source), {})[carrier] = power_dbm
        self._carriers = list(names)
        self._powers = powers
        self.header = ["epoch", "source", *(f"{name}_dbm" for name in names)]
        self.done, self.total = 0, len(powers)

    def rows(self) -> Iterator[FileRow]:
        """Yield the rows in order of epoch."""
        for number, ((epoch_us, source), levels) in enumerate(sorted(self._powers.items()), start=1):
            self.done = number
            cells: list[Any] = [epoch_us, source, *(levels.get(name) for name in self._carriers)]
            yield FileRow(number, cells)

    def close(self) -> None:
        """Nothing stays open."""
