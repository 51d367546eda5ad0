"""Parquet written piece by piece: what the writer has put out so far is taken away, so that memory holds one group."""

import io
from typing import Any

#: rows of a group; a reader holds one at a time, and so does the writer: 4 MB with 16 carriers
GROUP_ROWS = 65_536
#: cells of a group of record batches: a table of more than 40 columns has groups of fewer rows
GROUP_CELLS = 40 * GROUP_ROWS
#: batches that are made one: two sources that take turns come row by row, and a batch costs a kilobyte a column
MERGED_BATCHES = 512


class ParquetStream:
    """Writer whose bytes are taken as they come; zstd.

    Parameters
    ----------
    schema : pyarrow.Schema
        Columns.
    dictionary : sequence of str
        Columns of few different texts.
    """

    def __init__(self, schema: Any, dictionary: tuple[str, ...] = ()) -> None:
        # 90 ms that only Parquet needs
        import pyarrow as pa
        from pyarrow import parquet

        self._pa: Any = pa
        self._schema = schema
        self._group_rows = min(GROUP_ROWS, GROUP_CELLS // len(schema))
        self._sink = io.BytesIO()
        # bytes of floats side by side: neighbours of a column agree in the high ones
        split = [field.name for field in schema if pa.types.is_floating(field.type)]
        self._writer: Any = parquet.ParquetWriter(
            self._sink, schema, compression="zstd", use_dictionary=list(dictionary), use_byte_stream_split=split
        )
        self._fresh: list[Any] = []
        self._held: list[Any] = []
        self._held_rows = 0

    def add(self, batch: Any) -> bytes:
        """Add a record batch; return the bytes of the groups that it completes."""
        self._fresh.append(batch)
        self._held_rows += batch.num_rows
        if len(self._fresh) >= MERGED_BATCHES:
            self._merge()
        if self._held_rows >= self._group_rows:
            self._flush()
        return self.taken()

    def end(self) -> bytes:
        """Return the last group and the index."""
        self._flush(is_last=True)
        self._writer.close()
        return self.taken()

    def taken(self) -> bytes:
        """Return what the writer has put out since the last time."""
        taken = self._sink.getvalue()
        self._sink.seek(0)
        self._sink.truncate()
        return taken

    def _merge(self) -> None:
        """Make one batch of those that came last."""
        table = self._pa.Table.from_batches(self._fresh, schema=self._schema)
        self._held += table.combine_chunks().to_batches()
        self._fresh = []

    def _flush(self, *, is_last: bool = False) -> None:
        """Write whole groups; how rows came in batches leaves no trace, so the same rows make the same bytes."""
        table = self._pa.Table.from_batches([*self._held, *self._fresh], schema=self._schema)
        self._fresh, start = [], 0
        while table.num_rows - start >= self._group_rows or (is_last and start < table.num_rows):
            group = table.slice(start, self._group_rows).combine_chunks()
            self._writer.write_table(group, row_group_size=self._group_rows)
            start += self._group_rows
        self._held = table.slice(start).to_batches() if start < table.num_rows else []
        self._held_rows = max(table.num_rows - start, 0)
