"""Long work that an operator started, and replays."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

from service.records.catalogue import Method


class JobState(StrEnum):
    """Life of a job."""

    QUEUED = "queued"
    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class Job:
    """One piece of long work."""

    id: str
    kind: str
    state: JobState
    progress: Annotated[float, "0..1"]
    created_at_us: int
    error: Annotated[str | None, "Why it failed, and what to do."] = None


@dataclass(frozen=True, slots=True)
class Replay:
    """One replay; its rows are read under the version ``replay-<id>``."""

    id: int
    start_us: int
    stop_us: int
    #: None = every method
    method: Method | None
    calibration_id: int | None
    alignment_id: int
    #: journal or epoch
    order: str
    job_id: str
    created_at_us: int
    commands: Annotated[bool, "False: without torques."] = True
    #: whether the alignment was asked for, so that later ones of the journal do not replace it
    is_fixed_alignment: bool = False
    #: newest journal number that it reads; None = of a version that did not state it
    until_number: int | None = None
    smooth: Annotated[bool, "True: with rows of method `robust_smoothed` beside those of the robust method."] = False

    @property
    def version(self) -> str:
        """Name of the version in the archive."""
        return f"replay-{self.id}"


@dataclass(frozen=True, slots=True)
class ReplayVersion:
    """A replay and what became of it."""

    replay: Replay
    state: JobState
    progress: Annotated[float, "0..1"]
    error: Annotated[str | None, "Why it failed, and what to do."]
    attitude_rows: Annotated[int, "Attitude rows that it wrote, of all methods."]
    torque_rows: Annotated[int, "Torque commands that it wrote."]
    size_bytes: Annotated[int, "About how much they take before their days are sealed."]
