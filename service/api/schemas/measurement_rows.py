"""Measurements on their way out: rows of the archive, and the state of each carrier of the newest row.

Powers are stored as float32. They are told with the fewest digits that name the stored value, so that -42.1 that came
in is -42.1 that goes out.
"""

from collections.abc import Collection, Sequence
from typing import Self

import numpy as np

from service.api.schemas.base import Answer, EpochAnswer, Figure, RowPage
from service.api.schemas.record_answers import members_of
from service.formats.numbers import shortest_float32
from service.records.levels.attitude import CarrierState
from service.records.levels.measurement import DETAIL_NAMES, CarrierDetails, Measurement
from service.records.levels.quality_flag import flag_names

#: the estimator has a sigma of its own, which keeps the short name
_REPORTED_AS = {"sigma_db": "measured_sigma_db"}


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
    """True: its source was the prime one."""
    power_dbm: dict[str, float | None]
    """By carrier id, dBm; null = absent."""
    flags: dict[str, int] | None
    """Quality bit mask by carrier id."""
    flag_names: dict[str, list[str]] | None
    """Names of the flags of those carriers that have any."""
    measured_sigma_db: dict[str, float | None] | None
    """By carrier id, as the front end stated it; null = it stated none."""
    c_n0_db_hz: dict[str, float | None] | None
    occupied_bandwidth_hz: dict[str, float | None] | None
    centroid_offset_hz: dict[str, float | None] | None

    @classmethod
    def of(cls, row: Measurement, carrier_ids: Sequence[str], wanted: Collection[str] | None = None) -> Self:
        """Return the answer for a row, of all its carriers or of those wanted."""
        positions = [k for k, name in enumerate(carrier_ids) if wanted is None or name in wanted]
        power_dbm = shortest_float32(row.power_dbm)
        masks = None if row.flags is None else {carrier_ids[k]: int(row.flags[k]) for k in positions}
        return cls.model_validate(
            {
                "epoch": row.epoch_us,
                "received_at": row.received_at_us,
                "source": row.source,
                "seq": row.seq,
                "plan_id": row.plan_id,
                "late": row.is_late,
                "feeds_estimator": row.feeds_estimator,
                "power_dbm": {carrier_ids[k]: power_dbm[k] for k in positions},
                "flags": masks,
                "flag_names": None
                if masks is None
                else {name: flag_names(mask) for name, mask in masks.items() if mask},
                **_stated(row.details, carrier_ids, positions),
            }
        )


class MeasurementPage(RowPage):
    """Rows in order of epoch."""

    rows: list[MeasurementAnswer]


class CarrierStateAnswer(members_of(CarrierState), Answer):
    """State of one carrier after the newest row."""

    epoch: EpochAnswer
    measured_sigma_db: Figure
    """Scatter of the power that the front end predicts from bandwidth, time and noise."""
    c_n0_db_hz: Figure
    """Carrier over noise density, from the front end."""
    occupied_bandwidth_hz: Figure
    """Bandwidth that holds 99 per cent of the power, from the front end."""
    centroid_offset_hz: Figure
    """Centre of the power above the nominal frequency, from the front end."""
    flag_names: list[str]

    @classmethod
    def of(cls, row: Measurement, position: int, state: CarrierState) -> Self:
        """Return the answer for the state of the carrier at one place of a row."""
        measured = {name: None if by is None else by[position] for name, by in _statistics(row.details).items()}
        power_dbm, names = shortest_float32(np.array([state.power_dbm]))[0], flag_names(state.flags)
        return super().of(state, epoch=row.epoch_us, power_dbm=power_dbm, flag_names=names, **measured)


def _statistics(details: CarrierDetails | None) -> dict[str, list[float | None] | None]:
    """Return the details beside the powers of a row, under the names of answers, None = no such detail."""
    stated = {name: None if details is None else getattr(details, name) for name in DETAIL_NAMES}
    return {
        _REPORTED_AS.get(name, name): None if by is None or np.isnan(by).all() else shortest_float32(by)
        for name, by in stated.items()
    }


def _stated(
    details: CarrierDetails | None, carrier_ids: Sequence[str], positions: Sequence[int]
) -> dict[str, dict[str, float | None] | None]:
    """Return the details beside the powers of a row, by carrier."""
    return {
        name: None if by is None else {carrier_ids[k]: by[k] for k in positions}
        for name, by in _statistics(details).items()
    }
