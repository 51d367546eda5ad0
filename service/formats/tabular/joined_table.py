"""Columns of the joined series: one measurement with what one method made of it.

Columns: epoch, source, ``<carrier id>_dbm``; of each carrier ``_state``, ``_deviation_db`` and ``_residual_db``; those
of the attitude row; those of the torque command, each with ``command_`` before its name.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np

from service.formats.numbers import shortest_float32
from service.formats.tabular.measurement_file import MeasurementColumns
from service.formats.tabular.series_tables import JOINED_ATTITUDE, TORQUES
from service.formats.tabular.table_file import Column, Kind, SeriesTable
from service.records.levels.attitude import CARRIER_STATES, AttitudeRow, CarrierResults, TorqueCommand
from service.records.levels.measurement import Measurement

_OF_CARRIER: dict[str, Kind] = {"state": "text", "deviation_db": "figure", "residual_db": "figure"}


@dataclass(frozen=True, slots=True)
class JoinedRow:
    """One measurement and what one method made of it; None = nothing."""

    measurement: Measurement
    attitude: AttitudeRow | None
    carriers: CarrierResults | None
    command: TorqueCommand | None

    @property
    def epoch_us(self) -> int:
        """Epoch of the measurement."""
        return self.measurement.epoch_us


def joined_table(columns: MeasurementColumns) -> SeriesTable[JoinedRow]:
    """Return the table of joined rows.

    Parameters
    ----------
    columns : MeasurementColumns
        Carriers of the plans that occur.
    """
    names = [
        Column("epoch", "epoch"),
        Column("source", "text"),
        *(Column(f"{carrier}_dbm", "level") for carrier in columns.carriers),
        *(Column(f"{carrier}_{name}", kind) for carrier in columns.carriers for name, kind in _OF_CARRIER.items()),
        *JOINED_ATTITUDE.columns,
        *(Column(f"command_{column.name}", column.kind) for column in TORQUES.columns),
    ]

    def values(row: JoinedRow) -> Sequence[Any]:
        measurement = row.measurement
        levels = _placed(columns, measurement.plan_id, shortest_float32(measurement.power_dbm), None)
        return [
            measurement.epoch_us,
            measurement.source,
            *levels,
            *chain.from_iterable(_of_carriers(columns, row.carriers)),
            *_part(JOINED_ATTITUDE, row.attitude),
            *_part(TORQUES, row.command),
        ]

    return SeriesTable(tuple(names), values)


def _of_carriers(columns: MeasurementColumns, results: CarrierResults | None) -> Sequence[Sequence[Any]]:
    """Return state, deviation and residual of each carrier, as the interface answers them."""
    nothing = (None,) * len(_OF_CARRIER)
    if results is None:
        return [nothing] * len(columns.carriers)
    states = [CARRIER_STATES[state] for state in results.state.tolist()]
    decibels = np.round((results.deviation_db, results.residual_db), 3).tolist()
    return _placed(columns, results.plan_id, list(zip(states, *decibels, strict=True)), nothing)


def _placed(columns: MeasurementColumns, plan_id: int, values: Sequence[Any], nothing: Any) -> Sequence[Any]:
    """Return the values of the carriers of a plan by column."""
    positions = columns.positions_of(plan_id)
    if positions is None:
        return values
    placed = [nothing] * len(columns.carriers)
    for position, value in zip(positions.tolist(), values, strict=True):
        placed[position] = value
    return placed


def _part(table: SeriesTable[Any], record: AttitudeRow | TorqueCommand | None) -> Sequence[Any]:
    """Return the cells of a record, empty ones without it."""
    return (None,) * len(table.columns) if record is None else table.values(record)
