"""Alignments: a window with its sensors, or angles stated by hand."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from service.api.schemas.base import (
    Answer,
    CommentText,
    Document,
    Epoch,
    RowList,
    WindowAnswer,
)
from service.api.schemas.calibrations import SensorsDocument
from service.api.schemas.record_answers import members_of
from service.records.calibration import Alignment, CarrierReference, Window
from service.records.levels.attitude import Axes
from service.runtime.jobs.alignment_service import AlignmentRequest

AngleDeg = Annotated[float, Field(ge=-180, le=180)]
SigmaDeg = Annotated[float, Field(gt=0, le=180)]
_WINDOW_FIELDS = frozenset({"start", "stop", "sources"})
_MANUAL_FIELDS = frozenset({"epoch", "yaw_deg", "roll_deg", "pitch_deg", "sigma_deg"})
_DEFAULT_SENSOR = "star_tracker"


class SigmaDocument(Document):
    """One standard deviation of each angle."""

    yaw: SigmaDeg
    roll: SigmaDeg
    pitch: SigmaDeg


class AlignmentDocument(Document):
    """Either start, stop and source (or sources), or epoch, three angles and sigma_deg with source manual."""

    start: Epoch | None = None
    stop: Epoch | None = None
    source: Literal["star_tracker", "earth_sensor", "radio_beacon", "other", "manual"] | None = None
    sources: SensorsDocument | None = None
    """Sensor of each angle, in place of source."""
    epoch: Epoch | None = None
    yaw_deg: AngleDeg | None = None
    roll_deg: AngleDeg | None = None
    pitch_deg: AngleDeg | None = None
    sigma_deg: SigmaDocument | None = None
    override_reason: Annotated[CommentText, Field(min_length=1)] | None = None
    """Why the angles hold although the powers contradict them."""

    @property
    def is_manual(self) -> bool:
        """Return whether angles are stated by hand."""
        return self.source == "manual"

    @model_validator(mode="after")
    def _check_form(self) -> Self:
        """Refuse anything but one whole form."""
        stated = {name for name in _WINDOW_FIELDS | _MANUAL_FIELDS if getattr(self, name) is not None}
        required = _MANUAL_FIELDS if self.is_manual else {"start", "stop"}
        foreign = stated & (_WINDOW_FIELDS if self.is_manual else _MANUAL_FIELDS)
        missing = required - stated
        if missing or foreign:
            raise PydanticCustomError(
                "alignment.shape",
                "an alignment has start and stop with source or sources, or epoch, yaw_deg, roll_deg, pitch_deg and "
                "sigma_deg with source manual; missing: {missing}; not of this form: {foreign}",
                {"missing": _listed(missing), "foreign": _listed(foreign)},
            )
        if self.source is not None and self.sources is not None:
            raise PydanticCustomError("sources.ambiguous", "source for all angles and sources for each are both given")
        if self.start is not None and self.stop is not None and self.start >= self.stop:
            raise PydanticCustomError("range.invalid", "start must lie before stop")
        return self

    def to_request(self, created_by: str) -> AlignmentRequest:
        """Return the request that this document states."""
        return AlignmentRequest(
            window=None if self.start is None or self.stop is None else Window(self.start, self.stop),
            source_of_axis=None if self.is_manual else self._of_axis(),
            stated=self._stated(),
            override_reason=self.override_reason,
            created_by=created_by,
        )

    def _of_axis(self) -> tuple[str, str, str]:
        """Return the sensor of yaw, roll, pitch."""
        if self.sources is not None:
            return self.sources.yaw, self.sources.roll, self.sources.pitch
        sensor = self.source or _DEFAULT_SENSOR
        return sensor, sensor, sensor

    def _stated(self) -> tuple[int, Axes, Axes] | None:
        """Return epoch, angles and sigmas stated by hand."""
        if self.epoch is None or self.yaw_deg is None or self.roll_deg is None or self.pitch_deg is None:
            return None
        if self.sigma_deg is None:
            return None
        sigma = self.sigma_deg
        angles = Axes(self.yaw_deg, self.roll_deg, self.pitch_deg)
        return self.epoch, angles, Axes(sigma.yaw, sigma.roll, sigma.pitch)


class CarrierReferenceAnswer(members_of(CarrierReference), Answer):
    """Reference power of one carrier, harmonic removed."""


class AlignmentAnswer(
    members_of(
        Alignment,
        flat=("attitude_deg",),
        types={
            "window": WindowAnswer,
            "references": CarrierReferenceAnswer,
            "references_by_method": dict[str, list[CarrierReferenceAnswer]],
        },
    ),
    Answer,
):
    """An alignment; the newest holds for every method."""


class AlignmentMadeAnswer(AlignmentAnswer):
    """New alignment, with the numbers of stored rows that it changes or leaves."""

    rows_recomputed: int
    """Stored rows later than `epoch` that get angles by this alignment: those that had none."""
    rows_kept: int
    """Stored rows later than `epoch` that keep the angles of an earlier alignment, because control may have acted on
    them; a replay with this alignment (order epoch) computes them again beside the stored ones."""


class AlignmentList(RowList):
    """Alignments, newest first."""

    rows: list[AlignmentAnswer]


def _listed(names: set[str] | frozenset[str]) -> str:
    """Return names for a message."""
    return ", ".join(sorted(names)) or "nothing"
