"""Batches of measurements and what becomes of them; sources."""

from typing import Annotated, Literal

from pydantic import Field

from service.api.schemas.base import Answer, Document, EpochAnswer, Name, PlanNumber

#: stored as int32
Mask = Annotated[int, Field(ge=0, le=2**31 - 1)]


class MeasurementDocument(Document):
    """One row: one power for each carrier of the plan, in its order."""

    # checked as a whole batch by epochs.parse_epochs: a thousand times a second, one by one would cost more than JSON
    epoch: Annotated[str, Field(max_length=64, json_schema_extra={"format": "date-time"})]
    """Middle of the dwell, RFC 3339."""
    power_dbm: Annotated[list[float | None], Field(fail_fast=True)]
    """dBm, null = absent."""
    flags: Annotated[list[Mask], Field(fail_fast=True)] | None = None
    """Quality bit mask of each carrier."""


class MeasurementBatchDocument(Document):
    """Rows of one source under one plan."""

    plan_id: PlanNumber
    source: Name = "default"
    first_seq: Annotated[int, Field(ge=0, le=2**53)] | None = None
    """Sequence number of the first row; the others follow."""
    measurements: Annotated[list[MeasurementDocument], Field(fail_fast=True)]


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
