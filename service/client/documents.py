"""Answers of the service as types, by ``make schema``; a newer service may add fields."""

from typing import Any, Literal, TypedDict

Json = dict[str, Any]


class Angles(TypedDict):
    """One value an axis; absent = null."""

    #: Value of yaw; with a sign it is positive where stations in the east move north in the satellite's view.
    yaw: float | None
    #: Value of roll; with a sign it is positive where stations move south in the satellite's view.
    roll: float | None
    #: Value of pitch; with a sign it is positive where stations move west in the satellite's view.
    pitch: float | None


class AllowedAxes(TypedDict):
    """Permission for each axis."""

    #: Control about yaw is allowed.
    yaw: bool
    #: Control about roll is allowed.
    roll: bool
    #: Control about pitch is allowed.
    pitch: bool


class Refused(TypedDict):
    """A row that was refused, or flagged."""

    #: Place in the list that was sent, counted from 0.
    index: int
    #: Stable word for programs.
    code: str
    #: Sentence for people: what is wrong, and with which thing; it may change.
    detail: str
    #: Action that the code asks of the sender.
    next_step: str
    #: Number that the source gave the row; null where it numbers none.
    seq: int | None


class Receipt(TypedDict):
    """Receipt of committed rows; received = accepted + duplicates + len(refused), late is a part of accepted."""

    #: Entries that were sent.
    received: int
    #: Entries that are stored now.
    accepted: int
    #: Entries that were known already and left as they are.
    duplicates: int
    #: Accepted rows that are older than rows already consumed.
    late: int
    #: Accepted rows are on the disk.
    durable: bool
    #: Highest sequence number of the source that is stored; null before the first.
    last_seq: int | None
    #: Entries that were not stored, each with its reason.
    refused: list[Refused]
    #: Rows stored with a remark: `time.leap_second` (another epoch than sent), `seq.jump` (no gap is counted).
    flagged: list[Refused]


class CatalogueWarningReply(TypedDict):
    """Something doubtful in a document that was stored."""

    #: JSON pointer into the document.
    pointer: str
    #: Stable word for programs.
    code: str
    #: Sentence for people: what is wrong, and with which thing; it may change.
    detail: str


class PlanPut(TypedDict):
    """A stored plan."""

    #: Number of the plan.
    plan_id: int
    #: SHA-256 of the plan's content.
    sha256: str
    #: Number of carriers of the plan.
    carriers: int
    #: Stations that have the satellite below 5 deg elevation.
    warnings: list[CatalogueWarningReply]


class MeasurementReply(TypedDict):
    """One row of carrier powers."""

    #: Middle of the dwell.
    epoch: str
    #: When the service received it.
    received_at: str
    #: Source of the rows, as its sender named it.
    source: str
    #: Key that it came with; null: it was not asked.
    key_id: str | None
    #: Station of that key; null: a person sent it.
    station: str | None
    #: Number that the source gave the row; null where it numbers none.
    seq: int | None
    #: Carrier plan that gives the order of the carriers.
    plan_id: int
    #: Came late or out of order.
    late: bool
    #: True: its source was the prime one.
    feeds_estimator: bool
    #: By carrier id, dBm; null = absent.
    power_dbm: dict[str, float | None]
    #: Quality bit mask by carrier id.
    flags: dict[str, int] | None
    #: Names of the flags of those carriers that have any.
    flag_names: dict[str, list[str]] | None
    #: By carrier id, as the front end stated it; null = it stated none; dB.
    measured_sigma_db: dict[str, float | None] | None
    #: Carrier over noise density, by carrier id; null where it was not measured; dB Hz.
    c_n0_db_hz: dict[str, float | None] | None
    #: Bandwidth that holds 99 per cent of the power, by carrier id; null where it was not measured; Hz.
    occupied_bandwidth_hz: dict[str, float | None] | None
    #: Centre of the power above the nominal frequency, by carrier id; null where it was not measured; Hz.
    centroid_offset_hz: dict[str, float | None] | None


class ExclusionReply(TypedDict):
    """A carrier left out of the fix, and why."""

    #: Id of the carrier in its plan.
    carrier: str
    #: uplink_fade, step, absent, frozen, interference, group or manual.
    reason: str


class ControlReasonReply(TypedDict):
    """A reason why no torque may go, or why yaw is withheld."""

    #: Stable word for the reason.
    code: str
    #: Sentence for people.
    text: str
    #: Since when it has stood without a break; null: not known.
    since: str | None
    #: Next step of the operator.
    next_step: str


class AxisMotionReply(TypedDict):
    """An axis and its way to the limit; rate and time of a row that is old or lost are null."""

    #: Axis: yaw, roll or pitch.
    axis: Literal["yaw", "roll", "pitch"]
    #: The last known where it is lost; deg.
    angle_deg: float | None
    #: It is beyond its limit; yaw: surely, by two sigma.
    beyond: bool
    #: Slope of the angle over the last half hour, or since a commanded motion; without rows for it the estimator's;
    #: deg/h.
    rate_deg_h: float | None
    #: At this rate, of either sign; null: not within a day.
    hours_to_limit: float | None


class SituationReply(TypedDict):
    """The worst that is true of a spacecraft now, which every view says first."""

    #: Dark: no carrier is on the air; no_angles: of a first row; old: the newest row is.
    code: Literal[
        "estimator_failed",
        "no_attitude",
        "old",
        "dark",
        "lost",
        "no_angles",
        "beyond_and_growing",
        "beyond_limit",
        "towards_limit",
        "known",
    ]
    #: critical, serious, caution or normal; that of every view.
    severity: Literal["critical", "serious", "caution", "normal"]
    #: Of old, dark, lost and what is said of a limit.
    axis: Literal["yaw", "roll", "pitch"] | None
    #: Of this axis; the last known where it is old or lost; deg.
    angle_deg: float | None
    #: An angle is to stay within it; deg.
    limit_deg: float | None
    #: Positive: away from zero; deg/h.
    rate_deg_h: float | None
    #: At this rate; null: it does not go there.
    hours_to_limit: float | None
    #: Roll and pitch are known to it: the greater protection level, of a method without one two sigma; deg.
    known_deg: float | None
    #: The same of yaw; deg.
    yaw_known_deg: float | None
    #: Every axis whose angle is known.
    axes: list[AxisMotionReply]


class Verdict(TypedDict):
    """Permission to apply a torque now; the same object in every answer about the present."""

    #: False whenever the interlock or the newest attitude forbids; read this one for a decision.
    allowed: bool
    #: ENGAGED under release automatic: computed commands count as applied.
    state: Literal["INHIBITED", "ARMED", "ENGAGED", "RECOVERY", "BALANCE", "TRIPPED"]
    #: What to say first.
    situation: SituationReply
    #: All active reasons, the one to act on first; while allowed, those that withhold yaw alone.
    reasons: list[ControlReasonReply]


class Attitude(TypedDict):
    """The newest row of a method, with the verdict on control of the spacecraft."""

    #: Instant measured; null before the first row.
    epoch: str | None
    #: When the service received it.
    received_at: str | None
    #: Estimation method: `robust`, `paper`, or `robust_smoothed` in version `smoothed` and those of replays.
    method: Literal["robust", "paper", "robust_smoothed"]
    #: Yaw; positive moves eastern stations north in the satellite's view; deg.
    yaw_deg: float | None
    #: Roll; positive moves stations south in the satellite's view; deg.
    roll_deg: float | None
    #: Pitch; positive moves stations west in the satellite's view; deg.
    pitch_deg: float | None
    #: Null where the method knows no rate; deg/s.
    rates_deg_s: Angles | None
    #: One standard deviation; deg.
    sigma_deg: Angles
    #: ACQUIRED: angles of this row; EXPIRED: of older data; INVALID: none; NOT_RECEIVED: before the first row.
    status: Literal["ACQUIRED", "NOT_RECEIVED", "INVALID", "EXPIRED"]
    #: Permission of this estimate for control, yaw apart; it does not change. For now read `control.allowed`.
    control_allowed: bool
    #: The estimate may be used for control about each axis.
    control_allowed_axes: AllowedAxes
    #: Codes of the reasons why the estimate may not be used for control.
    inhibitions: list[str]
    #: Number of carriers that the row uses.
    carriers_used: int
    #: Carriers that the row leaves out, with the reason of each.
    excluded: list[ExclusionReply]
    #: Rain over the receiving site, or what acts like it, weakens all carriers.
    downlink_fade: bool
    #: Estimated loss common to all carriers; positive is weaker; dB.
    downlink_fade_db: float | None
    #: Level that all carriers share, against the alignment; negative is weaker, as in rain over the receiving site; dB.
    common_db: float | None
    #: Root mean square of measured minus modelled levels of the carriers used; dB.
    residual_rms_db: float | None
    #: Calibration that the row was computed with; null where none was active.
    calibration_id: int | None
    #: Alignment that the row was computed with; null before the first.
    alignment_id: int | None
    #: Advice to the operator while control goes on, such as `realign`.
    advice: list[str]
    #: Protection level: the error of the angle passes it with a probability of 1e-4 a row; null = not known; deg.
    protection_deg: Angles
    #: Smoothed rows: time from the row to the last one by which it was smoothed; null for other methods; s.
    lag_s: float | None
    #: Protection level if nothing were wrong with any carrier; deg.
    nominal_protection_deg: Angles
    #: Loss by two hours without control: turn by the torque, or an angle that is certain, the greater one; deg.
    waiting_loss_deg: Angles
    #: Angles that control steers by: of paper its fixes carried on by the dynamics; null: those of the row; deg.
    steering_deg: Angles
    #: One standard deviation of these angles; deg.
    steering_sigma_deg: Angles
    #: `live`, `smoothed`, or the replay that made the row.
    version: str
    #: Verdict on control: whether a torque may go now, and every reason against it.
    control: Verdict


class JobReply(TypedDict):
    """One piece of long work."""

    #: Id of the job.
    id: str
    #: Kind of the work: `calibration` or `replay`.
    kind: str
    #: `queued`, `running`, `done` or `failed`.
    state: Literal["queued", "running", "done", "failed"]
    #: 0..1
    progress: float
    #: When it was made.
    created_at: str
    #: Why it failed, and what to do.
    error: str | None
    #: Spacecraft that it is about.
    spacecraft_id: str | None
    #: Number of the calibration, or version of the replay.
    subject: str | None


class StatusReply(TypedDict):
    """Status of a spacecraft: newest rows, pending rows, documents in force."""

    #: Epoch of the newest measurement; null before the first.
    newest_measurement: str | None
    #: Of the method that drives control.
    newest_attitude: str | None
    #: Rows after the alignment's epoch without a result of every method that can run; 0 when not aligned.
    pending: int
    #: An alignment is in force.
    aligned: bool
    #: True: `advice` has `realign`.
    realignment_advised: bool
    #: Of the newest row of the robust method.
    advice: list[Json]
    #: True: the roll or pitch angles of both methods have differed for a quarter of an hour.
    methods_disagree: bool
    #: `system`, or `data`: the newest accepted epoch is the present of a simulated spacecraft.
    clock: Literal["system", "data"]
    #: Present of the spacecraft; null before its first row under the data clock.
    now: str | None
    #: Sources of measurements with the links that carry them.
    links: list[Json]
    #: Verdict on control: whether a torque may go now, and every reason against it.
    control: Verdict
    #: State of the interlock with its reasons.
    interlock: Json
    #: Method that drives control.
    method: str
    #: Newest active calibration.
    calibration_id: int | None
    #: Alignment in force.
    alignment_id: int | None


class PulseReply(TypedDict):
    """One element of a schedule."""

    #: Begin of the pulse, UTC.
    start: str
    #: Duration of the pulse; s.
    duration_s: float
    #: Torque about yaw; positive turns toward positive yaw; N m.
    yaw_n_m: float
    #: Torque about roll; positive turns toward positive roll; N m.
    roll_n_m: float
    #: Torque about pitch; positive turns toward positive pitch; N m.
    pitch_n_m: float


class Check(TypedDict):
    """One check of a command."""

    #: Name of the check.
    name: str
    #: The check is passed.
    ok: bool
    #: Fault of the command; empty where there is none.
    detail: str


class CommandReply(TypedDict):
    """A command that was prepared, as it stands."""

    #: Its counter, which stands in paths and in the uplink product.
    id: int
    #: State of the command; EXECUTED, FAILED, EXPIRED, CANCELLED and REJECTED are final.
    state: Literal[
        "PREPARED", "CONFIRMED", "RELEASED", "SENT", "EXECUTED", "FAILED", "EXPIRED", "CANCELLED", "REJECTED"
    ]
    #: Content that a second person confirms: SHA-256 of counter, estimate, start and pulses to the last bit.
    digest: str
    #: Number of the command, counted upward for each spacecraft.
    counter: int
    #: It cannot be confirmed from then on.
    expires_at: str
    #: `control`, or `sign_check`: a turn whose torque the filter is not told.
    purpose: Literal["control", "balance", "sign_check"]
    #: Reason of the command, as who prepared it stated it.
    reason: str
    #: The command is prepared and checked, and never sent.
    dry_run: bool
    #: The spacecraft is simulated.
    simulated: bool
    #: Released by standing authorisation.
    automatic: bool
    #: It waits for a second person, an approver.
    needs_approver: bool
    #: Epoch of the attitude row from which it was computed.
    attitude_epoch: str
    #: Begin of the first pulse, UTC.
    start: str
    #: End of the last pulse, UTC.
    stop: str
    #: Pulses of the command.
    schedule: list[PulseReply]
    #: Net angular impulse of the pulses about each axis; positive as the angle; N m s.
    impulse_n_m_s: Angles
    #: Sum of the sizes of the pulses: what the envelope counts; N m s.
    gross_impulse_n_m_s: Angles
    #: Effect of the pulses by prediction.
    predicted: Json
    #: As they were when it was prepared; all are made again when it is confirmed.
    checks: list[Check]
    #: Effect of the pulses on the flexible modes; null where there are none.
    schedule_check: Json | None
    #: Name of the operator's key.
    prepared_by: str
    #: When it was prepared.
    prepared_at: str
    #: Name of the approver's key; null before the confirmation.
    confirmed_by: str | None
    #: What the person wrote about it.
    comment: str
    #: When it was released; null before that.
    released_at: str | None
    #: When it was reported as sent to the spacecraft; null before that.
    sent_at: str | None
    #: Instant of the newest report on the command; null before the first.
    reported_at: str | None
    #: Name of the key that reported it; null before a report.
    reported_by: str | None
    #: Part of the schedule that was carried out, by report.
    executed: list[PulseReply]
    #: From the start to the horizon, where it is that of `predicted`; null in lists, events and answers of orders, and
    #: where the catalogue has another inertia since.
    predicted_angles: list[Json] | None


class Control(TypedDict):
    """State of the control interlock of a spacecraft."""

    #: Verdict on control: whether a torque may go now, and every reason against it.
    control: Verdict
    #: That of `control`.
    state: Literal["INHIBITED", "ARMED", "ENGAGED", "RECOVERY", "BALANCE", "TRIPPED"]
    #: Since when the interlock is in this state; null before anything happened.
    since: str | None
    #: Codes of the reasons of `control`.
    reasons: list[str]
    #: Latched until reset, a part of the reasons.
    trips: list[str]
    #: All that the verdict is made of; those that are not met are its reasons.
    conditions: list[Json]
    #: Minutes without a reason against control so far, and how many are needed.
    good_minutes: Json
    #: An angle is to stay within it; deg.
    angle_limit_deg: float
    #: Control was armed by a person; torques may go when the interlock allows it.
    armed: bool
    #: Computed commands are zeroed: from a trip until ten good minutes after its reset.
    withheld: bool
    #: Release of torques: `two_step` by two persons, or `automatic`.
    release: Literal["two_step", "automatic"]
    #: Place of the torque computation: `ground`, `onboard` or `off`.
    mode: Literal["ground", "onboard", "off"]
    #: That of the standing authorisation, else that of the settings.
    envelope: Json
    #: Approvers of the standing authorisation; empty without one.
    authorised_by: list[str]
    #: End of the standing authorisation; null without one.
    authorised_until: str | None
    #: Who waits for a second person to engage.
    requested_by: str | None
    #: End of the standing authorisation that waits for a second person; null without a request.
    requested_until: str | None
    #: Axes whose sign a check has proved.
    proven_axes: list[Literal["yaw", "roll", "pitch"]]
    #: Wait for a confirmation.
    open_commands: list[int]
    #: Wait for a report.
    unreported_commands: list[int]
    #: Sum of the sizes of what was sent within the hour; N m s.
    sent_impulse_n_m_s: Angles
    #: Newest check of the sign of an axis; null before the first.
    sign_check: Json | None
