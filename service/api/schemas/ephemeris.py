"""Documents of ephemerides: requests in one of three forms, and answers."""

from typing import Annotated, Self

from pydantic import ConfigDict, Field, model_validator
from pydantic.config import JsonDict
from pydantic_core import PydanticCustomError

from service.api.schemas.base import Answer, Document, Epoch, EpochAnswer, LatitudeDeg, LongitudeDeg, WindowAnswer
from service.formats.ephemeris.orbit import MAX_PERIOD_S, MAX_POINTS, MIN_PERIOD_S
from service.records.calibration import Window
from service.records.catalogue import Ephemeris, Track

_FORMS = ("ascending_nodes", "tle", "oem")
_ONE_FORM: JsonDict = {"oneOf": [{"required": [form]} for form in _FORMS]}


class TrackDocument(Document):
    """Predicted sub-satellite point; longitude absolute, latitude of the radius vector (geocentric)."""

    epochs: Annotated[tuple[Epoch, ...], Field(min_length=2, max_length=MAX_POINTS, fail_fast=True)]
    latitude_deg: Annotated[tuple[LatitudeDeg, ...], Field(max_length=MAX_POINTS, fail_fast=True)]
    longitude_deg: Annotated[tuple[LongitudeDeg, ...], Field(max_length=MAX_POINTS, fail_fast=True)]

    def to_record(self) -> Track:
        """Return the record that this document states."""
        return Track(self.epochs, self.latitude_deg, self.longitude_deg)


class EphemerisDocument(Document):
    """An orbit as node passages, as two-line elements or as a CCSDS OEM; exactly one of the three."""

    model_config = ConfigDict(json_schema_extra=_ONE_FORM)

    ascending_nodes: Annotated[tuple[Epoch, ...], Field(min_length=1, max_length=MAX_POINTS, fail_fast=True)] | None = (
        None
    )
    """Northward crossings of the equator, strictly ascending."""
    nodal_period_s: Annotated[float, Field(ge=MIN_PERIOD_S, le=MAX_PERIOD_S)] | None = None
    """Found from the nodes when left out."""
    track: TrackDocument | None = None
    """Without it the dish law is not available."""
    tle: tuple[Annotated[str, Field(max_length=100)], Annotated[str, Field(max_length=100)]] | None = None
    """Two-line elements."""
    oem: str | None = None
    """CCSDS Orbit Ephemeris Message, keyword = value notation."""
    relocating: bool = False
    """The spacecraft leaves its place: an orbit that contradicts the catalogue is stored. Stands in the audit log."""

    @model_validator(mode="after")
    def _check_form(self) -> Self:
        """Refuse anything but one form."""
        stated = [form for form in _FORMS if getattr(self, form) is not None]
        if len(stated) != 1:
            raise PydanticCustomError("ephemeris.form", "give exactly one of ascending_nodes, tle and oem")
        if self.ascending_nodes is None and (self.nodal_period_s is not None or self.track is not None):
            raise PydanticCustomError("ephemeris.form", "nodal_period_s and track belong to ascending_nodes only")
        return self


class TrackAnswer(Answer):
    """Predicted sub-satellite point."""

    epochs: list[EpochAnswer]
    latitude_deg: list[float]
    longitude_deg: list[float]


class EphemerisReceiptAnswer(Answer):
    """Receipt of a stored ephemeris: ascending nodes, nodal period and validity."""

    ephemeris_id: int
    ascending_nodes: list[EpochAnswer]
    nodal_period_s: float
    valid: WindowAnswer
    form: str

    @classmethod
    def of(cls, ephemeris: Ephemeris) -> Self:
        """Return the answer for a record."""
        return cls.model_validate(_content(ephemeris))


class EphemerisAnswer(EphemerisReceiptAnswer):
    """A stored ephemeris with its track."""

    track: TrackAnswer | None

    @classmethod
    def of(cls, ephemeris: Ephemeris) -> Self:
        """Return the answer for a record."""
        track = ephemeris.track
        content = None
        if track is not None:
            content = {
                "epochs": track.epochs_us,
                "latitude_deg": track.latitude_deg,
                "longitude_deg": track.longitude_deg,
            }
        return cls.model_validate({**_content(ephemeris), "track": content})


def _content(ephemeris: Ephemeris) -> dict[str, object]:
    """Return the members that both answers share."""
    return {
        "ephemeris_id": ephemeris.id,
        "ascending_nodes": ephemeris.ascending_nodes_us,
        "nodal_period_s": ephemeris.nodal_period_s,
        "valid": WindowAnswer.of(Window(ephemeris.valid_start_us, ephemeris.valid_stop_us)),
        "form": ephemeris.form,
    }
