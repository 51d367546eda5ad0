"""Batches of measurements and what becomes of them; sources."""

from typing import Annotated, Any, Literal, Required

from pydantic import ConfigDict, Field
from typing_extensions import TypedDict

from service.api.schemas.base import MAX_ROWS, Answer, Document, Name, PlanNumber, RowList
from service.api.schemas.record_answers import members_of
from service.api.schemas.row_refusals import RefusalAnswer
from service.records.levels.measurement import DETAIL_NAMES
from service.records.levels.series import SourceState

#: stored as int32
Mask = Annotated[int, Field(ge=0, le=2**31 - 1)]
#: figures of a row: beyond it decoding stops, below it a row of another width than its plan is refused by itself
_OF_A_ROW = Field(max_length=4096, fail_fast=True)
#: one figure of each carrier; the bounds are those of what an analyzer can tell
_Sigmas = Annotated[list[Annotated[float, Field(ge=0, le=1000)] | None], _OF_A_ROW]
_Densities = Annotated[list[Annotated[float, Field(ge=-300, le=300)] | None], _OF_A_ROW]
_Bandwidths = Annotated[list[Annotated[float, Field(ge=0, le=1e12)] | None], _OF_A_ROW]
_Offsets = Annotated[list[Annotated[float, Field(ge=-1e12, le=1e12)] | None], _OF_A_ROW]
#: integers that every reader of JSON keeps exact
MAX_SEQ = 2**53 - 1

#: all that most rows state
_PLAIN_FIELDS = frozenset({"epoch", "power_dbm", "flags"})


class MeasurementDocument(TypedDict, total=False):
    """One row: one power for each carrier of the plan, in its order."""

    # a dictionary, not a model: nothing is made for what a row does not state, which is a seventh of the decoding
    __pydantic_config__ = Document.model_config | ConfigDict(frozen=False)  # pydantic's own way

    # checked as a whole batch by epochs.parse_epochs: a thousand times a second, one by one would cost more than JSON
    epoch: Required[Annotated[str, Field(max_length=64, json_schema_extra={"format": "date-time"})]]
    """Middle of the dwell, RFC 3339."""
    power_dbm: Required[Annotated[list[float | None], _OF_A_ROW]]
    """dBm, null = absent."""
    flags: Annotated[list[Mask], _OF_A_ROW] | None
    """Quality bit mask of each carrier."""
    sigma_db: _Sigmas | None
    """Predicted scatter of each power, one sigma, dB."""
    c_n0_db_hz: _Densities | None
    """Carrier over noise density, dB Hz."""
    occupied_bandwidth_hz: _Bandwidths | None
    """Bandwidth that holds 99 per cent of the power, Hz."""
    centroid_offset_hz: _Offsets | None
    """Centre of the power above the nominal frequency, Hz."""


class MeasurementBatchDocument(Document):
    """Rows of one source under one plan."""

    plan_id: PlanNumber
    source: Name = "default"
    first_seq: Annotated[int, Field(ge=0, le=MAX_SEQ)] | None = None
    """Sequence number of the first row; the others follow."""
    measurements: Annotated[list[MeasurementDocument], Field(max_length=MAX_ROWS, fail_fast=True)]

    def details(self) -> list[dict[str, list[float | None]]] | None:
        """Return the details of each row beside its powers, None when no row has any."""
        if all(row.keys() <= _PLAIN_FIELDS for row in self.measurements):
            return None
        return [_details(row) for row in self.measurements]


def _details(row: MeasurementDocument) -> dict[str, list[float | None]]:
    """Return the details of a row beside its powers, by name."""
    stated: dict[str, Any] = {name: row.get(name) for name in DETAIL_NAMES}
    return {name: statistics for name, statistics in stated.items() if statistics is not None}


class RowRemarkAnswer(RefusalAnswer):
    """A row that was refused, or flagged."""

    seq: int | None


class MeasurementReceiptAnswer(Answer):
    """Receipt of committed rows; received = accepted + duplicates + len(refused), late is a part of accepted."""

    received: int
    accepted: int
    duplicates: int
    late: int
    durable: bool
    last_seq: int | None
    refused: list[RowRemarkAnswer]
    flagged: list[RowRemarkAnswer]
    """Rows stored with a remark: `time.leap_second` (another epoch than sent), `seq.jump` (no gap is counted)."""


class SourceAnswer(
    members_of(SourceState, without=("rows_missing",), types={"role": Literal["prime", "backup"]}), Answer
):
    """A front end that sends measurements; only the prime one feeds the estimator."""


class SourceListAnswer(RowList):
    """All sources of a spacecraft."""

    rows: list[SourceAnswer]
