"""Documents of attitude rows: the newest, the history and the live stream give the same document."""

from collections.abc import Sequence
from typing import Any, Self

import numpy as np

from service.api.schemas.base import Answer, EpochAnswer, Figure, WindowAnswer
from service.api.schemas.control import VerdictAnswer
from service.api.schemas.record_answers import RecordMembers
from service.records.catalogue import Method
from service.records.levels.attitude import AttitudeRow, Status, row_without_attitude
from service.records.levels.carrier_results import CARRIER_STATES, STEP_DB, CarrierResults


class ExclusionAnswer(Answer):
    """A carrier left out of the fix, and why."""

    carrier: str
    reason: str
    """uplink_fade, step, absent, frozen, interference, group or manual."""


_MEMBERS = RecordMembers(
    AttitudeRow,
    first=("epoch_us", "received_at_us", "method", "attitude_deg", "rates_deg_s"),
    without=("number",),
    flat=("attitude_deg",),
    types={"epoch_us": EpochAnswer | None, "received_at_us": EpochAnswer | None, "excluded": ExclusionAnswer},
    descriptions={"epoch": "Instant measured; null before the first row."},
)


class AttitudeAnswer(_MEMBERS.model("AttitudeMembers")):
    """Attitude estimate of one method at one measurement."""

    version: str
    """`live`, `smoothed`, or the replay that made the row."""

    @classmethod
    def of(cls, row: AttitudeRow, version: str, **others: Any) -> Self:
        """Return the answer for a row; ``others`` are members in place of those of the row."""
        members = _MEMBERS.values(row)
        members["version"] = version
        members.update(others)
        answer: Self = cls.model_validate(members)
        return answer

    @classmethod
    def not_received(cls, method: Method, version: str, **others: Any) -> Self:
        """Return the answer before the first row."""
        nothing = row_without_attitude(0, 0, 0, method, ("no_attitude",))
        return cls.of(nothing, version, epoch=None, received_at=None, status=Status.NOT_RECEIVED, **others)


class RowCarriersAnswer(Answer):
    """Results of the carriers of a plan at one row; lists in the order of `ids`."""

    plan_id: int
    ids: list[str]
    state: list[str]
    """used, absent, excluded, unselected or uncalibrated."""
    deviation_db: list[Figure]
    """Measured minus expected, to 0.002 dB; null = absent or not used."""
    residual_db: list[Figure]
    """Deviation minus what the attitude explains, to 0.002 dB."""

    @classmethod
    def of(cls, results: CarrierResults, ids: Sequence[str]) -> Self:
        """Return the answer for the carriers of a plan."""
        levels_db = np.rint(np.stack((results.deviation_db, results.residual_db)) / STEP_DB) * STEP_DB
        deviation_db, residual_db = np.round(levels_db, 3).tolist()
        state = [CARRIER_STATES[position] for position in results.state]
        members = {"plan_id": results.plan_id, "ids": list(ids), "state": state}
        return cls.model_validate({**members, "deviation_db": deviation_db, "residual_db": residual_db})


class AttitudeEventAnswer(AttitudeAnswer):
    """An attitude row as in events `attitude` of the stream: with what its method makes of the carriers."""

    carriers: RowCarriersAnswer | None
    """Null where nothing was computed of them, as of late rows."""


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


class SmoothedPage(AttitudePage):
    """Smoothed rows in order of epoch, one each five minutes at most; `lag_s` tells what each of them knows."""
