"""Evidence traces on their way in and out."""

from dataclasses import asdict
from typing import Annotated, Self

import numpy as np
from pydantic import Field

from service.api.schemas.base import Answer, AnyEpoch, Document, Name, RowPage
from service.api.schemas.record_answers import members_of
from service.api.schemas.row_refusals import RefusalAnswer
from service.formats.numbers import shortest_float32
from service.records.levels.trace import KeptTrace, Trace, TraceHead, TraceReceipt, TraceSettings

MAX_POINTS = 100_001
MAX_TRACES = 256
_Frequency = Annotated[float, Field(ge=0, le=1e12)]
_Width = Annotated[float, Field(gt=0, le=1e12)]
_Powers = Annotated[
    list[Annotated[float, Field(ge=-1e6, le=1e6)] | None], Field(min_length=1, max_length=MAX_POINTS, fail_fast=True)
]


class TraceDocument(Document):
    """One sweep, under the settings under which it was really taken."""

    epoch: AnyEpoch
    """Middle of the dwell."""
    sweep: Name
    """Name of the sweep in the measurement task."""
    start_hz: _Frequency
    """Of the first point."""
    step_hz: _Width
    rbw_hz: _Width
    enbw_hz: _Width
    """Noise bandwidth of the resolution filter."""
    sweep_time_s: Annotated[float, Field(ge=0, le=86_400)]
    power_dbm: _Powers
    """dBm behind the resolution filter, null where the analyzer gave no number."""

    def to_record(self) -> Trace:
        """Return the record that this document states."""
        settings = TraceSettings(self.start_hz, self.step_hz, self.rbw_hz, self.enbw_hz, self.sweep_time_s)
        return Trace(self.epoch, self.sweep, settings, np.array(self.power_dbm, dtype=np.float64))


class TraceBatchDocument(Document):
    """Traces of one source."""

    source: Name
    traces: Annotated[list[TraceDocument], Field(max_length=MAX_TRACES, fail_fast=True)]


class TraceRefusalAnswer(RefusalAnswer):
    """A refused trace."""


class TraceReceiptAnswer(members_of(TraceReceipt), Answer):
    """Receipt of committed traces; received = accepted + duplicates + len(refused)."""

    received: int
    refused: list[TraceRefusalAnswer]

    @classmethod
    def of(cls, receipt: TraceReceipt, refused: list[TraceRefusalAnswer]) -> Self:
        """Return the answer for a receipt."""
        received = receipt.accepted + receipt.duplicates + len(refused)
        return super().of(receipt, received=received, refused=refused)


class TraceHeadAnswer(
    members_of(TraceHead, without=("number", "settings")), members_of(TraceSettings, number=float), Answer
):
    """A kept trace without its points."""

    @classmethod
    def of(cls, head: TraceHead) -> Self:
        """Return the answer for a head."""
        return super().of(head, **asdict(head.settings))


class TraceAnswer(TraceHeadAnswer):
    """A kept trace; the frequency of point k is start_hz + k step_hz."""

    power_dbm: list[float | None]

    @classmethod
    def of_trace(cls, trace: KeptTrace) -> Self:
        """Return the answer for a trace."""
        head = TraceHeadAnswer.of(trace.head).model_dump()
        return cls.model_validate({**head, "power_dbm": shortest_float32(trace.power_dbm)})


class TracePage(RowPage):
    """Kept traces in order of epoch."""

    rows: list[TraceHeadAnswer]
