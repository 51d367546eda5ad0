"""Documents of ephemerides: requests in one of three forms, and answers."""

from typing import Annotated, Self

from pydantic import ConfigDict, Field, model_validator
from pydantic.config import JsonDict
from pydantic_core import PydanticCustomError

from service.api.schemas.base import Answer, Document, Epoch, LatitudeDeg, LongitudeDeg, WindowAnswer
from service.api.schemas.record_answers import members_of
from service.formats.ephemeris.oem import read_oem
from service.formats.ephemeris.orbit import MAX_PERIOD_S, MAX_POINTS, MIN_PERIOD_S, ephemeris_from_nodes
from service.formats.ephemeris.tle import read_tle
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
            raise PydanticCustomError("ephemeris.form", "not exactly one of ascending_nodes, tle and oem is given")
        if self.ascending_nodes is None and (self.nodal_period_s is not None or self.track is not None):
            raise PydanticCustomError("ephemeris.form", "nodal_period_s and track belong to ascending_nodes only")
        return self

    def to_record(self) -> Ephemeris:
        """Return the ephemeris of whichever form was given; InvalidInputError where it cannot be read."""
        if self.tle is not None:
            return read_tle(self.tle)
        if self.oem is not None:
            return read_oem(self.oem)
        track = None if self.track is None else self.track.to_record()
        return ephemeris_from_nodes(self.ascending_nodes or (), self.nodal_period_s, track)


class TrackAnswer(members_of(Track, number=float), Answer):
    """Predicted sub-satellite point."""


_WITHOUT = ("id", "valid_start_us", "valid_stop_us", "track")


class EphemerisReceiptAnswer(members_of(Ephemeris, without=_WITHOUT, number=float), Answer):
    """Receipt of a stored ephemeris: ascending nodes, nodal period and validity."""

    ephemeris_id: int
    valid: WindowAnswer

    @classmethod
    def of(cls, ephemeris: Ephemeris) -> Self:
        """Return the answer for a record."""
        valid = Window(ephemeris.valid_start_us, ephemeris.valid_stop_us)
        return super().of(ephemeris, ephemeris_id=ephemeris.id, valid=valid)


class EphemerisAnswer(EphemerisReceiptAnswer):
    """A stored ephemeris with its track."""

    track: TrackAnswer | None
