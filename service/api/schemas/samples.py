"""Samples of several quantities on one grid, column by column."""

from typing import Literal, NamedTuple, Self

import numpy as np

from service.api.schemas.base import Answer, EpochAnswer, WindowAnswer
from service.core.rows.summaries import IntArray, Summaries
from service.ports import AttitudeFigure, MeasuredFigure
from service.records.catalogue import Method
from service.records.epoch import format_epoch
from service.records.levels.attitude import BoolArray, FloatArray

ImpulseFigure = Literal["yaw_impulse_n_m_s", "roll_impulse_n_m_s", "pitch_impulse_n_m_s"]
CarrierFigure = Literal["deviation_db", "residual_db"]
Quantity = AttitudeFigure | ImpulseFigure | CarrierFigure | MeasuredFigure | Literal["expected_dbm"]


class SeriesName(NamedTuple):
    """Name of a sampled series."""

    quantity: Quantity
    #: of what a method made
    method: Method | None = None
    #: of what belongs to a carrier
    carrier: str | None = None


class SampledSeries(Answer):
    """One quantity; each list has one entry for each of the `epochs`."""

    quantity: Quantity
    method: Method | None
    """Null of powers, C/N0 and commands."""
    carrier: str | None
    n: list[int]
    """Rows that hold a value."""
    avg: list[float | None]
    min: list[float | None]
    max: list[float | None]
    min_epoch: list[str | None]
    """First row that holds the least value; empty where `extreme_epochs` is false."""
    max_epoch: list[str | None]

    @classmethod
    def of_column(cls, name: SeriesName, found: Summaries, *, has_epochs: bool) -> Self:
        """Return the answer for the one column of some intervals."""
        counts = found.counts[:, 0]
        is_held = counts > 0
        # the name is known and the arrays are ours: a validation of each number would cost more than all the rest
        return cls.model_construct(
            **name._asdict(),
            n=counts.tolist(),
            avg=_where(is_held, found.sums[:, 0] / np.maximum(counts, 1)),
            min=_where(is_held, found.minima[:, 0]),
            max=_where(is_held, found.maxima[:, 0]),
            min_epoch=_epochs_where(is_held, found.minimum_us[:, 0]) if has_epochs else [],
            max_epoch=_epochs_where(is_held, found.maximum_us[:, 0]) if has_epochs else [],
        )


class SampledQuantities(Answer):
    """Samples of several quantities in the same intervals, column by column; empty intervals are left out."""

    range: WindowAnswer
    """As asked, widened to whole intervals."""
    interval_s: int
    """Length of each: whole seconds, minutes, hours or days of UTC."""
    version: str
    """Of what was computed."""
    source: str | None
    """Source of the rows of powers and C/N0; null = of every source."""
    epochs: list[EpochAnswer]
    """Begins of the intervals in which any of the quantities has a value."""
    series: list[SampledSeries]


def _where(is_held: BoolArray, values: FloatArray) -> list[float | None]:
    return [value if held else None for held, value in zip(is_held.tolist(), values.tolist(), strict=True)]


def _epochs_where(is_held: BoolArray, epochs_us: IntArray) -> list[str | None]:
    pairs = zip(is_held.tolist(), epochs_us.tolist(), strict=True)
    return [format_epoch(epoch_us) if held else None for held, epoch_us in pairs]
