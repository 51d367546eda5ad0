"""Measurements on their way out: rows of the archive, and the state of each carrier of the newest row.

Powers are stored as float32. They are told with the fewest digits that name the stored value, so that -42.1 that came
in is -42.1 that goes out.
"""

from collections.abc import Collection, Sequence
from typing import Self

import numpy as np

from service.api.schemas.base import Answer, EpochAnswer, Figure, WindowAnswer
from service.formats.numbers import shortest_float32
from service.records.attitude import CarrierState
from service.records.measurement import Measurement


class MeasurementAnswer(Answer):
    """One row of carrier powers."""

    epoch: EpochAnswer
    """Middle of the dwell."""
    received_at: EpochAnswer
    source: str
    seq: int | None
    plan_id: int
    late: bool
    """Came late or out of order."""
    feeds_estimator: bool
    """Whether its source was the prime one."""
    power_dbm: dict[str, float | None]
    """By carrier id, dBm; null = absent."""
    flags: dict[str, int] | None
    """Quality bit mask by carrier id."""

    @classmethod
    def of(cls, row: Measurement, carrier_ids: Sequence[str], wanted: Collection[str] | None = None) -> Self:
        """Return the answer that tells a row, of all its carriers or of those wanted."""
        places = [k for k, name in enumerate(carrier_ids) if wanted is None or name in wanted]
        power_dbm = shortest_float32(row.power_dbm)
        return cls.model_validate(
            {
                "epoch": row.epoch_us,
                "received_at": row.received_at_us,
                "source": row.source,
                "seq": row.seq,
                "plan_id": row.plan_id,
                "late": row.is_late,
                "feeds_estimator": row.feeds_estimator,
                "power_dbm": {carrier_ids[k]: power_dbm[k] for k in places},
                "flags": None if row.flags is None else {carrier_ids[k]: int(row.flags[k]) for k in places},
            }
        )


class MeasurementPage(Answer):
    """Rows in order of epoch."""

    range: WindowAnswer
    rows: list[MeasurementAnswer]
    next: str | None


class CarrierStateAnswer(Answer):
    """What is known about one carrier after the newest row."""

    carrier: str
    epoch: EpochAnswer
    power_dbm: Figure
    expected_dbm: Figure
    """Reference power and daily harmonic."""
    deviation_db: Figure
    """Measured minus expected."""
    residual_db: Figure
    """Deviation minus what the attitude explains."""
    sigma_db: Figure
    c_n0_db_hz: Figure
    flags: int
    state: str
    """used, absent, excluded, unselected or uncalibrated."""

    @classmethod
    def of(cls, state: CarrierState, epoch_us: int) -> Self:
        """Return the answer that tells a state."""
        return cls.model_validate(
            {
                "carrier": state.carrier,
                "epoch": epoch_us,
                "power_dbm": shortest_float32(np.array([state.power_dbm]))[0],
                "expected_dbm": state.expected_dbm,
                "deviation_db": state.deviation_db,
                "residual_db": state.residual_db,
                "sigma_db": state.sigma_db,
                "c_n0_db_hz": state.c_n0_db_hz,
                "flags": state.flags,
                "state": state.state,
            }
        )
