"""Answers of the service as types: what they hold stands in the OpenAPI document, these are its names for programs.

Answers stay plain dictionaries; a field that a newer service adds is there though it has no name here.
``tests/docs/test_client_documents.py`` compares every type with the OpenAPI document.
"""

from typing import Any, Literal, TypedDict

Json = dict[str, Any]


class Angles(TypedDict):
    """One value an axis; None = absent."""

    yaw: float | None
    roll: float | None
    pitch: float | None


class AllowedAxes(TypedDict):
    """Which axes may be controlled."""

    yaw: bool
    roll: bool
    pitch: bool


class Refused(TypedDict):
    """A row that was not stored, and why."""

    index: int
    seq: int | None
    code: str
    detail: str


class Receipt(TypedDict):
    """What became of the rows of a batch of measurements."""

    received: int
    accepted: int
    duplicates: int
    #: among the accepted ones
    late: int
    durable: bool
    last_seq: int | None
    refused: list[Refused]
    #: rows stored with a remark: time.leap_second, seq.jump
    flagged: list[Refused]


class CatalogueWarning(TypedDict):
    """Something doubtful in a document that was stored."""

    pointer: str
    code: str
    detail: str


class PlanPut(TypedDict):
    """A carrier plan that was stored."""

    plan_id: int
    sha256: str
    carriers: int
    #: stations that have the satellite low
    warnings: list[CatalogueWarning]


class Measurement(TypedDict):
    """One row of carrier powers; every dictionary is by carrier id."""

    epoch: str
    received_at: str
    source: str
    seq: int | None
    plan_id: int
    late: bool
    feeds_estimator: bool
    power_dbm: dict[str, float | None]
    flags: dict[str, int] | None
    flag_names: dict[str, list[str]] | None
    measured_sigma_db: dict[str, float | None] | None
    c_n0_db_hz: dict[str, float | None] | None
    occupied_bandwidth_hz: dict[str, float | None] | None
    centroid_offset_hz: dict[str, float | None] | None


class Exclusion(TypedDict):
    """A carrier left out of a fix, and why."""

    carrier: str
    reason: str


class ControlReason(TypedDict):
    """A reason why no torque may go, or why yaw is withheld."""

    code: str
    text: str
    since: str | None
    next_step: str


class Verdict(TypedDict):
    """Verdict on control: read `allowed` for a decision."""

    allowed: bool
    state: Literal["INHIBITED", "ARMED", "ENGAGED", "RECOVERY", "TRIPPED"]
    reasons: list[ControlReason]


class Attitude(TypedDict):
    """The newest attitude of one method; angles None = not known."""

    epoch: str | None
    received_at: str | None
    method: str
    yaw_deg: float | None
    roll_deg: float | None
    pitch_deg: float | None
    rates_deg_s: Angles | None
    sigma_deg: Angles
    status: str
    control_allowed: bool
    control_allowed_axes: AllowedAxes
    inhibitions: list[str]
    carriers_used: int
    excluded: list[Exclusion]
    downlink_fade: bool
    downlink_fade_db: float | None
    common_db: float | None
    residual_rms_db: float | None
    calibration_id: int | None
    alignment_id: int | None
    advice: list[str]
    version: str
    #: of the spacecraft now; `control_allowed` is of this estimate
    control: Verdict


class Job(TypedDict):
    """A calculation that takes its time."""

    state: Literal["queued", "running", "done", "failed"]
    progress: float
    error: str | None
    #: path of what it gave, for analyses
    result: str | None


class Status(TypedDict):
    """What is newest, pending and in force of a spacecraft."""

    newest_measurement: str | None
    newest_attitude: str | None
    pending: int
    aligned: bool
    realignment_advised: bool
    advice: list[Json]
    methods_disagree: bool
    clock: Literal["system", "data"]
    now: str | None
    links: list[Json]
    control: Verdict
    interlock: Json
    method: str
    calibration_id: int | None
    alignment_id: int | None


class Pulse(TypedDict):
    """One element of a schedule; torque on the body."""

    start: str
    duration_s: float
    roll_n_m: float
    pitch_n_m: float
    yaw_n_m: float


class Check(TypedDict):
    """One check of a command."""

    name: str
    ok: bool
    detail: str


class Command(TypedDict):
    """A command that was prepared, as it stands."""

    id: int
    state: str
    digest: str
    counter: int
    expires_at: str
    purpose: str
    reason: str
    dry_run: bool
    simulated: bool
    automatic: bool
    needs_approver: bool
    attitude_epoch: str
    start: str
    stop: str
    schedule: list[Pulse]
    impulse_n_m_s: Angles
    gross_impulse_n_m_s: Angles
    predicted: Json
    checks: list[Check]
    schedule_check: Json | None
    prepared_by: str
    prepared_at: str
    confirmed_by: str | None
    comment: str
    released_at: str | None
    sent_at: str | None
    reported_at: str | None
    reported_by: str | None
    executed: list[Pulse]


class Control(TypedDict):
    """What the interlock of a spacecraft says."""

    control: Verdict
    state: Literal["INHIBITED", "ARMED", "ENGAGED", "RECOVERY", "TRIPPED"]
    since: str | None
    reasons: list[str]
    trips: list[str]
    armed: bool
    withheld: bool
    release: str
    mode: str
    envelope: Json
    authorised_by: list[str]
    authorised_until: str | None
    requested_by: str | None
    requested_until: str | None
    proven_axes: list[str]
    open_commands: list[int]
    unreported_commands: list[int]
    sent_impulse_n_m_s: Angles
    sign_check: Json | None
