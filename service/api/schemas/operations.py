"""Operations: what the control centre declares, so that it is explained or inhibits control."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from service.api.schemas.base import AnglesDocument, Answer, CommentText, Document, Epoch, Name, RowPage, record_of
from service.api.schemas.record_answers import members_of
from service.records.inputs import Operation

OperationKind = Literal[
    "station_keeping",
    "momentum_unloading",
    "eclipse",
    "sun_outage",
    "carrier_work",
    "gain_change",
    "receive_chain_work",
    "calibration_turn",
    "other",
]
#: kinds that turn the spacecraft or blind the station: they stop control unless it is said otherwise
INHIBITING_KINDS = frozenset({"station_keeping", "momentum_unloading", "receive_chain_work", "calibration_turn"})
Names = Annotated[tuple[Name, ...], Field(min_length=1, max_length=512)]


class OperationDocument(Document):
    """A declared operation."""

    kind: OperationKind
    start: Epoch
    stop: Epoch | None = None
    """null = open until it is changed."""
    carriers: Names | None = None
    """Carriers that it touches; null = all or none in particular."""
    transponders: Names | None = None
    inhibit_control: bool | None = None
    """null = true for station_keeping, momentum_unloading, receive_chain_work and calibration_turn, else false."""
    attitude_uncertainty_deg: AnglesDocument | None = None
    comment: CommentText = ""

    @model_validator(mode="after")
    def _check_interval(self) -> Self:
        """Refuse an interval that ends before it starts."""
        if self.stop is not None and self.start >= self.stop:
            raise PydanticCustomError("range.invalid", "start must lie before stop")
        return self

    @model_validator(mode="after")
    def _check_uncertainty(self) -> Self:
        """Refuse negative uncertainties."""
        angles = self.attitude_uncertainty_deg or AnglesDocument()
        if any(value is not None and not 0 <= value <= 180 for value in (angles.yaw, angles.roll, angles.pitch)):
            raise PydanticCustomError("value.range", "attitude_uncertainty_deg must lie in 0..180")
        return self

    def to_record(self, operation_id: int) -> Operation:
        """Return the record that this document states."""
        does_inhibit = self.kind in INHIBITING_KINDS if self.inhibit_control is None else self.inhibit_control
        return record_of(Operation, self, id=operation_id, inhibit_control=does_inhibit)


class OperationAnswer(members_of(Operation, first=("id", "revision")), Answer):
    """A stored operation."""


class OperationPage(RowPage):
    """Operations that overlap the range, in order of start."""

    rows: list[OperationAnswer]
