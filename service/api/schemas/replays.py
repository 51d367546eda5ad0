"""Replays: what to run again, and the version under which its rows are read."""

from typing import Literal, Self

from pydantic import model_validator
from pydantic_core import PydanticCustomError

from service.api.schemas.base import Answer, RowPage, record_of
from service.api.schemas.calibrations import Identifier, WindowDocument
from service.api.schemas.live_method import LiveMethod
from service.api.schemas.record_answers import members_of
from service.records.catalogue import Method
from service.records.operations.job import Replay, ReplayVersion
from service.records.record_fields import record_fields


class ReplayDocument(WindowDocument):
    """A stretch of the archive to run again."""

    method: LiveMethod | None = None
    """Null: every method."""
    calibration_id: Identifier | None = None
    """In place of those that the journal activates."""
    alignment_id: Identifier | None = None
    """In place of the one that held at start."""
    order: Literal["journal", "epoch"] = "journal"
    """As it was, or as it would have been with late rows in their place."""
    commands: bool = True
    """False leaves out the torques."""
    smooth: bool = False
    """True adds rows of method `robust_smoothed`: the robust rows after those that came later. They drive nothing."""

    @model_validator(mode="after")
    def _smooth_what_is_robust(self) -> Self:
        """Refuse to smooth where the robust method does not run."""
        if self.smooth and self.method is Method.PAPER:
            detail = "only the robust method has smoothed rows"
            raise PydanticCustomError("method.smoothed", detail)
        return self

    def to_replay(self) -> Replay:
        """Return the replay that this document asks for; number, job and time are given later."""
        return record_of(Replay, self, id=0, alignment_id=self.alignment_id or 0, job_id="", created_at_us=0)


class ReplayStartedAnswer(Answer):
    """A replay that is running."""

    id: int
    job: str
    version: str
    """Name under which its rows are read on history and export."""


class ReplayAnswer(
    members_of(ReplayVersion, without=("replay",), number=float),
    members_of(Replay, without=("id", "job_id", "is_fixed_alignment", "until_number")),
    ReplayStartedAnswer,
):
    """One replay; its rows are read when its state is ``done``."""

    @classmethod
    def of(cls, found: ReplayVersion) -> Self:
        """Return the answer for a replay and what became of it."""
        became = {name: getattr(found, name) for name in record_fields(ReplayVersion) if name != "replay"}
        return super().of(found.replay, job=found.replay.job_id, **became)


class ReplayPage(RowPage):
    """One page of replays."""

    rows: list[ReplayAnswer]
