"""Attitude rows as they go out: the newest, the history and the live stream tell the same document."""

from typing import Self

from service.api.schemas.base import AnglesAnswer, Answer, EpochAnswer, Figure, WindowAnswer
from service.api.schemas.control import VerdictAnswer
from service.records.catalogue import Method
from service.records.levels.attitude import AttitudeRow, Status


class AllowedAxesAnswer(Answer):
    """Which axes may be controlled."""

    yaw: bool
    roll: bool
    pitch: bool


class ExclusionAnswer(Answer):
    """A carrier left out of the fix, and why."""

    carrier: str
    reason: str
    """uplink_fade, step, absent, interference, group or manual."""


class AttitudeAnswer(Answer):
    """What one method says about one measurement."""

    epoch: EpochAnswer | None
    """Instant measured; null before the first row."""
    received_at: EpochAnswer | None
    method: Method
    yaw_deg: Figure
    roll_deg: Figure
    pitch_deg: Figure
    rates_deg_s: AnglesAnswer | None
    """Null where the method knows no rate."""
    sigma_deg: AnglesAnswer
    """One standard deviation."""
    status: Status
    control_allowed: bool
    """Whether this estimate may be used for control: no inhibition stands; yaw alone may be withheld. It is stored and
    does not change; whether a torque may go now is told by `control.allowed` of the newest answer."""
    control_allowed_axes: AllowedAxesAnswer
    inhibitions: list[str]
    carriers_used: int
    excluded: list[ExclusionAnswer]
    downlink_fade: bool
    downlink_fade_db: Figure
    common_db: Figure
    residual_rms_db: Figure
    calibration_id: int | None
    alignment_id: int | None
    advice: list[str]
    """What the operator is advised while control goes on: `realign`."""
    version: str
    """`live`, or the replay that made the row."""

    @classmethod
    def of(cls, row: AttitudeRow, version: str) -> Self:
        """Return the answer that tells a row."""
        yaw_deg, roll_deg, pitch_deg = row.attitude_deg
        yaw_allowed, roll_allowed, pitch_allowed = row.control_allowed_axes
        return cls.model_validate(
            {
                "epoch": row.epoch_us,
                "received_at": row.received_at_us,
                "method": row.method,
                "yaw_deg": yaw_deg,
                "roll_deg": roll_deg,
                "pitch_deg": pitch_deg,
                "rates_deg_s": row.rates_deg_s,
                "sigma_deg": row.sigma_deg,
                "status": row.status,
                "control_allowed": row.control_allowed,
                "control_allowed_axes": {"yaw": yaw_allowed, "roll": roll_allowed, "pitch": pitch_allowed},
                "inhibitions": row.inhibitions,
                "carriers_used": row.carriers_used,
                "excluded": row.excluded,
                "downlink_fade": row.downlink_fade,
                "downlink_fade_db": row.downlink_fade_db,
                "common_db": row.common_db,
                "residual_rms_db": row.residual_rms_db,
                "calibration_id": row.calibration_id,
                "alignment_id": row.alignment_id,
                "advice": row.advice,
                "version": version,
            }
        )

    @classmethod
    def not_received(cls, method: Method, version: str) -> Self:
        """Return the answer before the first row."""
        return cls(
            epoch=None,
            received_at=None,
            method=method,
            yaw_deg=None,
            roll_deg=None,
            pitch_deg=None,
            rates_deg_s=None,
            sigma_deg=AnglesAnswer(yaw=None, roll=None, pitch=None),
            status=Status.NOT_RECEIVED,
            control_allowed=False,
            control_allowed_axes=AllowedAxesAnswer(yaw=False, roll=False, pitch=False),
            inhibitions=["no_attitude"],
            carriers_used=0,
            excluded=[],
            downlink_fade=False,
            downlink_fade_db=None,
            common_db=None,
            residual_rms_db=None,
            calibration_id=None,
            alignment_id=None,
            advice=[],
            version=version,
        )


class NewestAttitudeAnswer(AttitudeAnswer):
    """The newest row of a method, with the verdict on control of the spacecraft."""

    control: VerdictAnswer


class AttitudePage(Answer):
    """Rows in order of epoch, exactly one a measurement and method."""

    range: WindowAnswer
    method: Method
    version: str
    rows: list[AttitudeAnswer]
    next: str | None
