"""A chain that flies over a small payload of real places, and the documents that it asks for.

Powers come from geometry that is written once more in ``flight_geometry``; what was measured is made in
``flight_payload``.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from flight_geometry import CITIES, HOUR, INERTIA, LONGITUDE_DEG, MINUTE, PERIOD_S, SC, SITE, START_US, S
from flight_payload import FlightPayload
from synthetic_payload import opening

from service.pipeline.chain import METHODS, Chain
from service.pipeline.config import ChainConfig
from service.pipeline.inputs.knowledge import JournalDocuments
from service.records.catalogue import Method, Spacecraft
from service.records.levels.attitude import AppliedCommand, AttitudeRow, Axes, FloatArray, Pulse, TorqueCommand
from service.records.levels.measurement import Measurement

__all__ = [
    "CITIES",
    "HOUR",
    "INERTIA",
    "LONGITUDE_DEG",
    "MINUTE",
    "PERIOD_S",
    "SC",
    "SITE",
    "START_US",
    "Flight",
    "FlightDocuments",
    "FlightPayload",
    "S",
    "applied_command",
]


class FlightDocuments(JournalDocuments):
    """Documents by number, as a test lays them down."""

    def __init__(self, payload: FlightPayload, aligned_us: int, angles_deg: Any) -> None:
        aligned = payload.alignment(aligned_us, angles_deg=angles_deg)
        super().__init__({1: payload.plan()}, {1: payload.ephemeris()}, {1: payload.calibration()}, {1: aligned})


def applied_command(
    epoch_us: int, schedule: tuple[Pulse, ...], number: int = 1, period_s: float = 60.0
) -> AppliedCommand:
    """Return a command of some pulses that counts as applied."""
    zero, wheels, until_us = Axes(0.0, 0.0, 0.0), (0.0, 0.0, 0.0), epoch_us + round(period_s * S)
    head = (epoch_us, number, epoch_us, "ground", zero, wheels, False, period_s, until_us)
    return AppliedCommand(TorqueCommand(*head, schedule, zero, zero, zero, wheels, True, ()))


class Flight:
    """A chain over an exact payload, aligned one hour after the start at the true attitude."""

    def __init__(
        self,
        payload: FlightPayload,
        truth_deg: Any = (0.1, -0.15, 0.2),
        *,
        spacecraft: Spacecraft | None = None,
        methods: Any = METHODS,
        is_opened: bool = True,
    ) -> None:
        self.payload = payload
        self.truth_deg = np.array(truth_deg)
        self.aligned_us = START_US + HOUR
        self.documents = FlightDocuments(payload, self.aligned_us, self.truth_deg.tolist())
        self.chain = Chain(self.documents, ChainConfig(), None, methods)
        self.spacecraft = spacecraft or payload.spacecraft()
        if is_opened:
            for content in self.opening():
                self.chain.update(content)

    def opening(self) -> tuple[Any, ...]:
        """Return the slow inputs with which the journal opens."""
        return opening(self.spacecraft)

    def at(self, minute: float) -> int:
        """Return the epoch of a minute after the alignment."""
        return round(self.aligned_us + minute * MINUTE)

    def row(self, minute: float, angles_deg: Any = None, **changes: Any) -> Measurement:
        """Return the row of a minute; at the true attitude of the alignment unless another is named."""
        return self.payload.measurement(
            self.at(minute), self.truth_deg if angles_deg is None else angles_deg, **changes
        )

    def changed(self, minute: float, change_db: Any, angles_deg: Any = None, **changes: Any) -> Measurement:
        """Return a row whose powers (N,) are other by some decibel, NaN = absent."""
        row = self.row(minute, angles_deg, **changes)
        return replace(row, power_dbm=row.power_dbm + np.asarray(change_db))

    def feed(self, measurement: Measurement, **options: Any) -> dict[Method, AttitudeRow]:
        """Feed a row and return what each method says."""
        outcome = self.chain.step(measurement, **options)
        return {row.method: row for row in outcome.rows} if outcome is not None else {}

    def robust(self, measurement: Measurement, **options: Any) -> AttitudeRow:
        """Feed a row and return what the robust method says."""
        return self.feed(measurement, **options)[Method.ROBUST]

    def run(self, minutes: Any, change_db: Any = 0.0, **options: Any) -> list[AttitudeRow]:
        """Feed rows and return those of the robust method."""
        return [self.robust(self.changed(minute, change_db, **options)) for minute in minutes]

    def error_deg(self, row: AttitudeRow) -> FloatArray:
        """Return how far a row is from the attitude of the alignment (3,)."""
        return np.asarray(np.array(row.attitude_deg) - self.truth_deg)
