"""Measurement task: which sweeps the analyzer takes and which carriers are found in them.

A task is a JSON file with a version of its format; its hash is logged with the measurement, so that every row can be
traced to the settings that made it. Frequencies are those at the analyzer's input plus ``input.freq_offset_hz``.
"""

import hashlib
from pathlib import Path
from typing import Annotated, Final, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from service.records.field_faults import faults_text

#: format of the task file that this release reads
TASK_FORMAT: Final = 1

_Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
_Number = Annotated[float, Field(allow_inf_nan=False)]
_Name = Annotated[str, Field(min_length=1, max_length=64)]


class TaskError(Exception):
    """The task cannot be read or contradicts itself; the text names the place."""


class _Part(BaseModel):
    """Part of a task: unknown fields are errors, nothing changes after loading."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class AnalyzerPart(_Part):
    """Address and dialect of the analyzer."""

    #: VISA resource name; the command line may name another
    resource: str | None = None
    #: auto takes the driver from ``*IDN?``
    dialect: Literal["auto", "rs", "keysight", "siglent", "anritsu", "generic"] = "auto"
    #: bound on every answer but that of a sweep, s
    io_timeout_s: _Positive = 5.0
    #: noise bandwidth of the resolution filters over their RBW; in place of the dialect's
    enbw_ratio: Annotated[float, Field(ge=0.8, le=1.5)] | None = None
    #: give the front panel back after every cycle
    is_shared: bool = False


class InputPart(_Part):
    """Signal path between the test point and the analyzer's input."""

    #: dB added to every level; or pairs (Hz, dB), interpolated
    level_offset_db: _Number | tuple[tuple[_Number, _Number], ...] = 0.0
    #: Hz added to every frequency of the task to get the analyzer's
    freq_offset_hz: _Number = 0.0
    attenuation_db: _Number | None = None
    ref_level_dbm: _Number | None = None
    preamp: bool | None = None
    #: displayed average noise level of the analyzer at its input, dBm/Hz; without it nothing is flagged
    danl_dbm_hz: _Number | None = None


class SweepPart(_Part):
    """One sweep of the analyzer."""

    id: _Name
    start_hz: _Positive
    stop_hz: _Positive
    rbw_hz: _Positive
    vbw_hz: _Positive | None = None
    points: Annotated[int, Field(ge=11, le=100_001)]
    #: None couples the time to span and bandwidth
    time_s: _Positive | None = None
    detector: Literal["RMS"] = "RMS"
    count: Annotated[int, Field(ge=1, le=1000)] = 1

    @model_validator(mode="after")
    def _is_ordered(self) -> Self:
        if self.stop_hz <= self.start_hz:
            message = f"sweep {self.id}: stop_hz is not above start_hz"
            raise ValueError(message)
        return self


class LimitsPart(_Part):
    """Nominal level and limits of a carrier; used for the prediction of its scatter."""

    nominal_dbm: _Number | None = None
    warn_db: _Positive | None = None
    alarm_db: _Positive | None = None
    #: smallest C/N0 at which the carrier still serves, dB-Hz
    c_n0_min: _Number | None = None
    #: wanted standard deviation of its level, dB
    sigma_goal_db: _Positive | None = None


class CarrierPart(_Part):
    """One carrier in one sweep."""

    id: _Name
    sweep: _Name
    fc_hz: _Positive
    #: symbols a second; not needed for a beacon
    symbol_rate: _Positive | None = None
    rolloff: Annotated[float, Field(ge=0.0, le=1.0)] = 0.25
    integ_bw_hz: _Positive
    kind: Literal["modulated", "beacon"] = "modulated"
    #: frequencies beside the carrier where only noise is
    noise: Annotated[tuple[tuple[_Positive, _Positive], ...], Field(min_length=1)]
    limits: LimitsPart = LimitsPart()

    @model_validator(mode="after")
    def _is_complete(self) -> Self:
        if self.kind == "modulated" and self.symbol_rate is None:
            message = f"carrier {self.id}: a modulated carrier needs symbol_rate"
            raise ValueError(message)
        if any(high <= low for low, high in self.noise):
            message = f"carrier {self.id}: a noise window ends before it begins"
            raise ValueError(message)
        return self

    @property
    def occupied_hz(self) -> float:
        """Bandwidth outside of which the carrier is zero, Hz; of a beacon its integration bandwidth."""
        return self.integ_bw_hz if self.symbol_rate is None else self.symbol_rate * (1.0 + self.rolloff)


class TaskHead(_Part):
    """Name and pace of the task."""

    id: _Name
    #: time from row to row, s; 0 = as fast as the analyzer answers
    period_s: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = 5.0
    analyzer: AnalyzerPart = AnalyzerPart()
    #: auto lets the planner give narrow carriers sweeps of their own
    zoom: Literal["off", "auto"] = "off"


class MeasurementTask(_Part):
    """Measurement task: carriers, sweeps, period and signal path."""

    format: Literal[1] = TASK_FORMAT
    task: TaskHead
    input: InputPart = InputPart()
    sweeps: Annotated[tuple[SweepPart, ...], Field(min_length=1, max_length=32)]
    carriers: Annotated[tuple[CarrierPart, ...], Field(min_length=1, max_length=512)]

    @model_validator(mode="before")
    @classmethod
    def _gather_head(cls, document: object) -> object:
        """Let ``id``, ``period_s`` and ``analyzer`` stand at the top as well as under ``task``."""
        if not isinstance(document, dict) or "task" in document:
            return document
        head = {name: document[name] for name in TaskHead.model_fields if name in document}
        return {"task": head} | {name: value for name, value in document.items() if name not in head}

    def carriers_of(self, sweep_id: str) -> tuple[CarrierPart, ...]:
        """Return the carriers of one sweep, in the order of the task."""
        return tuple(carrier for carrier in self.carriers if carrier.sweep == sweep_id)


def parse_task(content: bytes) -> tuple[MeasurementTask, str]:
    """Return the task of a JSON document and the SHA-256 of its bytes.

    Raises
    ------
    TaskError
        Not JSON, or not a task; every fault with its place.
    """
    try:
        task = MeasurementTask.model_validate_json(content)
    except ValidationError as error:
        raise TaskError(faults_text(error.errors(), "task")) from error
    return task, hashlib.sha256(content).hexdigest()


def load_task(path: Path) -> tuple[MeasurementTask, str]:
    """Return the task of a file and the SHA-256 of its bytes.

    Raises
    ------
    TaskError
        The file cannot be read, or holds no task.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        message = f"task {path}: {error.strerror}"
        raise TaskError(message) from error
    try:
        return parse_task(content)
    except TaskError as error:
        message = f"task {path}: {error}"
        raise TaskError(message) from error
