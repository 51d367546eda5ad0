"""Files of single days made one file, format by format."""

import importlib
import os
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import IO, Any

_COPIED_BYTES = 1 << 20


def joined(file_format: str, paths: Sequence[Path], output: Path) -> None:
    """Write the files of days, in their order, as one file that is on the disk when this returns.

    Parameters
    ----------
    file_format : str
        ``csv``, ``ndjson``, ``parquet``, ``aem`` or ``tdm``.
    paths : sequence of Path
        At least one.
    output : Path
        Written again.
    """
    if file_format == "parquet":
        _join_parquet(paths, output)
    else:
        pass_head = _HEADS[file_format]
        with output.open("wb") as target:
            for number, path in enumerate(paths):
                with path.open("rb") as day:
                    if number:
                        pass_head(day)
                    shutil.copyfileobj(day, target, _COPIED_BYTES)
    with output.open("rb") as file:
        os.fsync(file.fileno())


def _pass_line(day: IO[bytes]) -> None:
    """Pass over the header line."""
    day.readline()


def _pass_header(day: IO[bytes]) -> None:
    """Pass over what stands before the first segment of a message."""
    while line := day.readline():
        if line.strip() == b"META_START":
            day.seek(-len(line), os.SEEK_CUR)
            return


def _pass_nothing(_: IO[bytes]) -> None:
    """Begin at the beginning."""


_HEADS: dict[str, Callable[[IO[bytes]], None]] = {
    "csv": _pass_line,
    "ndjson": _pass_nothing,
    "aem": _pass_header,
    "tdm": _pass_header,
}


def _join_parquet(paths: Sequence[Path], output: Path) -> None:
    """Write the groups of rows of every file, one in memory at a time."""
    # tens of megabytes that only this format needs
    parquet: Any = importlib.import_module("pyarrow.parquet")
    schema = parquet.read_schema(paths[0])
    with parquet.ParquetWriter(output, schema, compression="zstd") as writer:
        for path in paths:
            with parquet.ParquetFile(path) as day:
                for group in range(day.num_row_groups):
                    writer.write_table(day.read_row_group(group).cast(schema))
