"""Documents of measurements, of what becomes of each carrier, and of evidence traces."""

from collections.abc import Collection, Sequence
from dataclasses import asdict
from typing import Annotated, Any, Literal, Required, Self

import numpy as np
from pydantic import ConfigDict, Field
from typing_extensions import TypedDict

from service.api.schemas.base import (
    MAX_ROWS,
    Answer,
    AnyEpoch,
    Document,
    EpochAnswer,
    Figure,
    Name,
    PlanNumber,
    RefusalAnswer,
    RowList,
    RowPage,
    members_of,
    with_descriptions,
)
from service.formats.numbers import shortest_float32
from service.records.catalogue import Method
from service.records.levels.attitude import (
    CARRIER_HYPOTHESES,
    CARRIER_STATES,
    AttitudeRow,
    CarrierResults,
    CarrierState,
)
from service.records.levels.measurement import (
    DETAIL_NAMES,
    CarrierDetails,
    KeptTrace,
    Measurement,
    SourceState,
    Trace,
    TraceHead,
    TraceReceipt,
    TraceSettings,
    flag_names,
)

#: the estimator has a sigma of its own, which keeps the short name
_REPORTED_AS = {"sigma_db": "measured_sigma_db"}


class MeasurementAnswer(Answer):
    """One row of carrier powers."""

    epoch: EpochAnswer
    """Middle of the dwell."""
    received_at: EpochAnswer
    source: str
    key_id: str | None
    """Key that it came with; null: it was not asked."""
    station: str | None
    """Station of that key; null: a person sent it."""
    seq: int | None
    plan_id: int
    late: bool
    """Came late or out of order."""
    feeds_estimator: bool
    """True: its source was the prime one."""
    power_dbm: dict[str, float | None]
    """By carrier id, dBm; null = absent."""
    flags: dict[str, int] | None
    """Quality bit mask by carrier id."""
    flag_names: dict[str, list[str]] | None
    """Names of the flags of those carriers that have any."""
    measured_sigma_db: dict[str, float | None] | None
    """By carrier id, as the front end stated it; null = it stated none."""
    c_n0_db_hz: dict[str, float | None] | None
    occupied_bandwidth_hz: dict[str, float | None] | None
    centroid_offset_hz: dict[str, float | None] | None

    @classmethod
    def of(cls, row: Measurement, carrier_ids: Sequence[str], wanted: Collection[str] | None = None) -> Self:
        """Return the answer for a row, of all its carriers or of those wanted."""
        positions = [k for k, name in enumerate(carrier_ids) if wanted is None or name in wanted]
        power_dbm = shortest_float32(row.power_dbm)
        masks = None if row.flags is None else {carrier_ids[k]: int(row.flags[k]) for k in positions}
        return cls.model_validate(
            {
                "epoch": row.epoch_us,
                "received_at": row.received_at_us,
                "source": row.source,
                "key_id": row.key_id,
                "station": row.station,
                "seq": row.seq,
                "plan_id": row.plan_id,
                "late": row.is_late,
                "feeds_estimator": row.feeds_estimator,
                "power_dbm": {carrier_ids[k]: power_dbm[k] for k in positions},
                "flags": masks,
                "flag_names": None
                if masks is None
                else {name: flag_names(mask) for name, mask in masks.items() if mask},
                **_stated(row.details, carrier_ids, positions),
            }
        )


class MeasurementPage(RowPage[MeasurementAnswer]):
    """Rows in order of epoch."""


class CarrierStateAnswer(members_of(CarrierState), Answer):
    """State of one carrier after the newest row."""

    epoch: EpochAnswer
    measured_sigma_db: Figure
    """Scatter of the power that the front end predicts from bandwidth, time and noise."""
    c_n0_db_hz: Figure
    """Carrier over noise density, from the front end."""
    occupied_bandwidth_hz: Figure
    """Bandwidth that holds 99 per cent of the power, from the front end."""
    centroid_offset_hz: Figure
    """Centre of the power above the nominal frequency, from the front end."""
    flag_names: list[str]

    @classmethod
    def of(cls, row: Measurement, position: int, state: CarrierState) -> Self:
        """Return the answer for the state of the carrier at one place of a row."""
        measured = {name: None if by is None else by[position] for name, by in _statistics(row.details).items()}
        power_dbm, names = shortest_float32(np.array([state.power_dbm]))[0], flag_names(state.flags)
        return super().of(state, epoch=row.epoch_us, power_dbm=power_dbm, flag_names=names, **measured)


def _statistics(details: CarrierDetails | None) -> dict[str, list[float | None] | None]:
    """Return the details beside the powers of a row, under the names of answers, None = no such detail."""
    stated = {name: None if details is None else getattr(details, name) for name in DETAIL_NAMES}
    return {
        _REPORTED_AS.get(name, name): None if by is None or np.isnan(by).all() else shortest_float32(by)
        for name, by in stated.items()
    }


def _stated(
    details: CarrierDetails | None, carrier_ids: Sequence[str], positions: Sequence[int]
) -> dict[str, dict[str, float | None] | None]:
    """Return the details beside the powers of a row, by carrier."""
    return {
        name: None if by is None else {carrier_ids[k]: by[k] for k in positions}
        for name, by in _statistics(details).items()
    }


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


@with_descriptions
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


class SourceListAnswer(RowList[SourceAnswer]):
    """All sources of a spacecraft."""


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


class TracePage(RowPage[TraceHeadAnswer]):
    """Kept traces in order of epoch."""


class CarrierResultAnswer(Answer):
    """Results of one carrier at one measurement, by one method."""

    epoch: EpochAnswer
    state: str | None
    """used, absent, excluded, unselected or uncalibrated; null where nothing is stored: the carrier is not in the plan
    of the row, the row was late, or nothing was computed for it."""
    reason: str | None
    """Why it is left out, as in `excluded` of the attitude row."""
    deviation_db: Figure
    """Measured minus expected, to 0.002 dB; null = absent or not used."""
    residual_db: Figure
    """Deviation minus what the attitude explains, to 0.002 dB."""
    hypothesis: str | None
    """Likeliest state by the references of the alignment: dry, wet, level_changed or level_learned."""
    plan_id: int | None

    @classmethod
    def of(cls, row: AttitudeRow, results: CarrierResults | None, position: int | None, carrier: str) -> Self:
        """Return the answer for the carrier at one place of a row's plan; None: nothing is known of it."""
        reason = next((each.reason for each in row.excluded if each.carrier == carrier), None)
        known: dict[str, Any] = dict.fromkeys(("state", "deviation_db", "residual_db", "hypothesis", "plan_id"))
        if results is not None and position is not None:
            known = {
                "state": CARRIER_STATES[results.state[position]],
                "deviation_db": round(float(results.deviation_db[position]), 3),
                "residual_db": round(float(results.residual_db[position]), 3),
                "hypothesis": CARRIER_HYPOTHESES[results.hypothesis[position]],
                "plan_id": results.plan_id,
            }
        return cls.model_validate({"epoch": row.epoch_us, "reason": reason, **known})


class CarrierResultPage(RowPage[CarrierResultAnswer]):
    """Rows in order of epoch, exactly one a measurement and method."""

    carrier: str
    method: Method
    version: str
