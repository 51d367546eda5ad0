"""Batches of measurements and what becomes of them; sources."""

from typing import Annotated, Literal

from pydantic import Field

from service.api.schemas.base import Answer, Document, EpochAnswer, Name, PlanNumber
from service.records.measurement import DETAIL_NAMES

#: stored as int32
Mask = Annotated[int, Field(ge=0, le=2**31 - 1)]
#: stored as float32; no figure of an analyzer lies beyond
_Figures = Annotated[list[Annotated[float, Field(ge=-1e15, le=1e15)] | None], Field(fail_fast=True)]

#: all that most rows state
_PLAIN_FIELDS = frozenset({"epoch", "power_dbm", "flags"})


class MeasurementDocument(Document):
    """One row: one power for each carrier of the plan, in its order."""

    # checked as a whole batch by epochs.parse_epochs: a thousand times a second, one by one would cost more than JSON
    epoch: Annotated[str, Field(max_length=64, json_schema_extra={"format": "date-time"})]
    """Middle of the dwell, RFC 3339."""
    power_dbm: Annotated[list[float | None], Field(fail_fast=True)]
    """dBm, null = absent."""
    flags: Annotated[list[Mask], Field(fail_fast=True)] | None = None
    """Quality bit mask of each carrier."""
    sigma_db: _Figures | None = None
    """Predicted scatter of each power, one sigma, dB."""
    c_n0_db_hz: _Figures | None = None
    """Carrier over noise density, dB Hz."""
    occupied_bandwidth_hz: _Figures | None = None
    """Bandwidth that holds 99 per cent of the power, Hz."""
    centroid_offset_hz: _Figures | None = None
    """Centre of the power above the nominal frequency, Hz."""

    def details(self) -> dict[str, list[float | None]]:
        """Return what is stated beside the powers, by name."""
        stated = {name: getattr(self, name) for name in DETAIL_NAMES}
        return {name: figures for name, figures in stated.items() if figures is not None}


class MeasurementBatchDocument(Document):
    """Rows of one source under one plan."""

    plan_id: PlanNumber
    source: Name = "default"
    first_seq: Annotated[int, Field(ge=0, le=2**53)] | None = None
    """Sequence number of the first row; the others follow."""
    measurements: Annotated[list[MeasurementDocument], Field(fail_fast=True)]

    def details(self) -> list[dict[str, list[float | None]]] | None:
        """Return what each row states beside its powers, None when none states any."""
        if all(row.model_fields_set <= _PLAIN_FIELDS for row in self.measurements):
            return None
        return [row.details() for row in self.measurements]


class RowRefusalAnswer(Answer):
    """A refused row."""

    index: int
    seq: int | None
    code: str
    detail: str


class MeasurementReceiptAnswer(Answer):
    """What was committed; received = accepted + duplicates + len(refused), late is a part of accepted."""

    received: int
    accepted: int
    duplicates: int
    late: int
    durable: bool
    last_seq: int | None
    refused: list[RowRefusalAnswer]


class SourceAnswer(Answer):
    """A front end that sends measurements; only the prime one feeds the estimator."""

    id: str
    role: Literal["prime", "backup"]
    newest_epoch: EpochAnswer | None
    rows: int


class SourceListAnswer(Answer):
    """All sources of a spacecraft."""

    rows: list[SourceAnswer]
    next: str | None = None
