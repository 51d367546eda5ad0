"""Answers of the service as types; written from the OpenAPI document by ``make schema``, not by hand.

Answers stay plain dictionaries; a field that a newer service adds is there though it has no name here.
"""

from typing import Any, Literal, TypedDict

Json = dict[str, Any]


class Angles(TypedDict):
    """One value an axis; absent = null."""

    yaw: float | None
    roll: float | None
    pitch: float | None


class AllowedAxes(TypedDict):
    """Permission of control for each axis."""

    yaw: bool
    roll: bool
    pitch: bool


class Refused(TypedDict):
    """A row that was refused, or flagged."""

    index: int
    seq: int | None
    code: str
    detail: str


class Receipt(TypedDict):
    """Receipt of committed rows; received = accepted + duplicates + len(refused), late is a part of accepted."""

    received: int
    accepted: int
    duplicates: int
    late: int
    durable: bool
    last_seq: int | None
    refused: list[Refused]
    #: Rows stored with a remark: `time.leap_second` (another epoch than sent), `seq.jump` (no gap is counted).
    flagged: list[Refused]


class CatalogueWarningReply(TypedDict):
    """Something doubtful in a document that was stored."""

    #: JSON pointer into the document.
    pointer: str
    code: str
    detail: str


class PlanPut(TypedDict):
    """A stored plan."""

    plan_id: int
    sha256: str
    carriers: int
    #: Stations that have the satellite below 5 deg elevation.
    warnings: list[CatalogueWarningReply]


class MeasurementReply(TypedDict):
    """One row of carrier powers."""

    #: Middle of the dwell.
    epoch: str
    received_at: str
    source: str
    seq: int | None
    plan_id: int
    #: Came late or out of order.
    late: bool
    #: Whether its source was the prime one.
    feeds_estimator: bool
    #: By carrier id, dBm; null = absent.
    power_dbm: dict[str, float | None]
    #: Quality bit mask by carrier id.
    flags: dict[str, int] | None
    #: Names of the flags of those carriers that have any.
    flag_names: dict[str, list[str]] | None
    #: By carrier id, as the front end stated it; null = it stated none.
    measured_sigma_db: dict[str, float | None] | None
    c_n0_db_hz: dict[str, float | None] | None
    occupied_bandwidth_hz: dict[str, float | None] | None
    centroid_offset_hz: dict[str, float | None] | None


class ExclusionReply(TypedDict):
    """A carrier left out of the fix, and why."""

    carrier: str
    #: uplink_fade, step, absent, frozen, interference, group or manual.
    reason: str


class ControlReasonReply(TypedDict):
    """A reason why no torque may go, or why yaw is withheld."""

    code: str
    text: str
    #: Since when it has stood without a break; null: not known.
    since: str | None
    next_step: str


class Verdict(TypedDict):
    """Permission to apply a torque now; the same object in every answer about the present."""

    #: False whenever the interlock or the newest attitude forbids; read this one for a decision.
    allowed: bool
    #: ENGAGED under release automatic: computed commands count as applied.
    state: Literal["INHIBITED", "ARMED", "ENGAGED", "RECOVERY", "TRIPPED"]
    #: All active reasons, the one to act on first; while allowed, those that withhold yaw alone.
    reasons: list[ControlReasonReply]


class Attitude(TypedDict):
    """The newest row of a method, with the verdict on control of the spacecraft."""

    #: Instant measured; null before the first row.
    epoch: str | None
    received_at: str | None
    method: Literal["robust", "paper", "robust_smoothed"]
    yaw_deg: float | None
    roll_deg: float | None
    pitch_deg: float | None
    #: Null where the method knows no rate.
    rates_deg_s: Angles | None
    #: One standard deviation.
    sigma_deg: Angles
    status: Literal["ACQUIRED", "NOT_RECEIVED", "INVALID", "EXPIRED"]
    #: Whether this estimate may be used for control: no inhibition stands; yaw alone may be withheld. It is stored and
    #: does not change; whether a torque may go now is told by `control.allowed` of the newest answer.
    control_allowed: bool
    control_allowed_axes: AllowedAxes
    inhibitions: list[str]
    carriers_used: int
    excluded: list[ExclusionReply]
    downlink_fade: bool
    downlink_fade_db: float | None
    common_db: float | None
    residual_rms_db: float | None
    calibration_id: int | None
    alignment_id: int | None
    #: What the operator is advised while control goes on: `realign`.
    advice: list[str]
    #: Protection level: the error of the angle passes it with a probability of 1e-4 a row; null = not known.
    protection_deg: Angles
    #: Smoothed rows: time from the row to the last one by which it was smoothed; null for other methods.
    lag_s: float | None
    #: `live`, or the replay that made the row.
    version: str
    control: Verdict


class JobReply(TypedDict):
    """One piece of long work."""

    id: str
    kind: str
    state: Literal["queued", "running", "done", "failed"]
    #: 0..1
    progress: float
    created_at: str
    #: Why it failed, and what to do.
    error: str | None
    #: Path of its result while that is kept; null for jobs whose result is another resource.
    result: str | None


class StatusReply(TypedDict):
    """Status of a spacecraft: newest rows, pending rows, documents in force."""

    newest_measurement: str | None
    #: Of the method that drives control.
    newest_attitude: str | None
    #: Rows after the alignment's epoch without a result of every method that can run; 0 when not aligned.
    pending: int
    aligned: bool
    #: Whether `advice` has `realign`.
    realignment_advised: bool
    #: Of the newest row of the robust method.
    advice: list[Json]
    #: Whether the roll or pitch angles of both methods have differed for a quarter of an hour.
    methods_disagree: bool
    clock: Literal["system", "data"]
    #: Present of the spacecraft; null before its first row under the data clock.
    now: str | None
    links: list[Json]
    control: Verdict
    interlock: Json
    #: Method that drives control.
    method: str
    #: Newest active calibration.
    calibration_id: int | None
    #: Alignment in force.
    alignment_id: int | None


class PulseReply(TypedDict):
    """One element of a schedule."""

    start: str
    duration_s: float
    yaw_n_m: float
    roll_n_m: float
    pitch_n_m: float


class Check(TypedDict):
    """One check of a command."""

    name: str
    ok: bool
    #: What is wrong; empty where nothing is.
    detail: str


class CommandReply(TypedDict):
    """A command that was prepared, as it stands."""

    #: Its counter, which stands in paths and in the uplink product.
    id: int
    state: Literal[
        "PREPARED", "CONFIRMED", "RELEASED", "SENT", "EXECUTED", "FAILED", "EXPIRED", "CANCELLED", "REJECTED"
    ]
    #: What a second person confirms: SHA-256 of counter, estimate, start and pulses to the last bit.
    digest: str
    counter: int
    #: It cannot be confirmed from then on.
    expires_at: str
    purpose: Literal["control", "sign_check"]
    reason: str
    dry_run: bool
    simulated: bool
    #: Released by standing authorisation.
    automatic: bool
    #: It waits for a second person, an approver.
    needs_approver: bool
    attitude_epoch: str
    start: str
    stop: str
    schedule: list[PulseReply]
    impulse_n_m_s: Angles
    #: Sum of the sizes of the pulses: what the envelope counts.
    gross_impulse_n_m_s: Angles
    predicted: Json
    #: As they were when it was prepared; all are made again when it is confirmed.
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
    #: What of the schedule was carried out, by report.
    executed: list[PulseReply]


class Control(TypedDict):
    """State of the control interlock of a spacecraft."""

    control: Verdict
    #: That of `control`.
    state: Literal["INHIBITED", "ARMED", "ENGAGED", "RECOVERY", "TRIPPED"]
    since: str | None
    #: Codes of the reasons of `control`.
    reasons: list[str]
    #: Latched until reset, a part of the reasons.
    trips: list[str]
    #: All that the verdict is made of; those that are not met are its reasons.
    conditions: list[Json]
    good_minutes: Json
    armed: bool
    #: Computed commands are zeroed: from a trip until ten good minutes after its reset.
    withheld: bool
    release: Literal["two_step", "automatic"]
    mode: Literal["ground", "onboard", "off"]
    #: That of the standing authorisation, else that of the settings.
    envelope: Json
    authorised_by: list[str]
    authorised_until: str | None
    #: Who waits for a second person to engage.
    requested_by: str | None
    requested_until: str | None
    proven_axes: list[Literal["yaw", "roll", "pitch"]]
    #: Wait for a confirmation.
    open_commands: list[int]
    #: Wait for a report.
    unreported_commands: list[int]
    #: Sum of the sizes of what was sent within the hour.
    sent_impulse_n_m_s: Angles
    sign_check: Json | None
