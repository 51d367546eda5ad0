"""Station file: the analyzers that one front end measures with, each with its task and its source.

A JSON list, or an object with the list under ``analyzers``. Paths of tasks are relative to the file.
"""

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, model_validator

from service.frontend.measurement_task import TaskError
from service.records.field_faults import faults_text

_Name = Annotated[str, Field(min_length=1, max_length=64)]


class StationEntry(BaseModel):
    """One analyzer."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    #: measurement task, relative to the station file
    task: Path
    spacecraft: _Name
    #: name of this source of measurements
    source: _Name = "sa-1"
    #: VISA resource name, in place of the task's
    resource: str | None = None
    #: time from row to row in place of the task's, s; 0 = as fast as the analyzer answers
    period_s: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] | None = None
    #: whose clock stamps the rows
    epoch: Literal["system", "analyzer"] = "system"
    #: further wait for a sweep that a trigger holds back, s
    hold_s: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = 0.0


class StationFile(BaseModel):
    """All analyzers of a front end."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    analyzers: Annotated[tuple[StationEntry, ...], Field(min_length=1, max_length=63)]

    @model_validator(mode="before")
    @classmethod
    def _read_list(cls, document: object) -> object:
        """Let a bare list stand for the analyzers."""
        return {"analyzers": document} if isinstance(document, list) else document

    @model_validator(mode="after")
    def _have_sources_of_their_own(self) -> Self:
        sources = [(entry.spacecraft, entry.source) for entry in self.analyzers]
        twice = sorted(
            {f"{spacecraft}.{source}" for spacecraft, source in sources if sources.count((spacecraft, source)) > 1}
        )
        if twice:
            message = f"two analyzers are {', '.join(twice)}: give each a source of its own"
            raise ValueError(message)
        return self


def load_station(path: Path) -> tuple[StationEntry, ...]:
    """Return the analyzers of a station file, paths made absolute.

    Raises
    ------
    TaskError
        The file cannot be read, or is no station file.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        message = f"station {path}: {error.strerror}"
        raise TaskError(message) from error
    try:
        station = TypeAdapter(StationFile).validate_json(content)
    except ValidationError as error:
        message = f"station {path}: {faults_text(error.errors(), 'station')}"
        raise TaskError(message) from error
    return tuple(entry.model_copy(update={"task": path.parent / entry.task}) for entry in station.analyzers)
