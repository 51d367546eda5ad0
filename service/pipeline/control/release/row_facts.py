"""What the interlock must know of an attitude row, taken from the row itself."""

from typing import NamedTuple

from service.pipeline.control.release.interlock_conditions import RowFacts
from service.pipeline.estimation.method import CommandEvidence
from service.ports import Outcome
from service.records.levels.attitude import AttitudeRow, Status

#: standard normal quantile of 0.995: 99 % lie between it and its opposite
_QUANTILE = 2.5758293
#: an attitude has three unknowns
_UNKNOWNS = 3


class SeenRow(NamedTuple):
    """A row as the release sees it, after it was stored."""

    outcome: Outcome
    evidence: CommandEvidence | None = None


def facts_of_row(row: AttitudeRow, period_s: float, *, is_innovation_in_band: bool) -> RowFacts:
    """Return the facts of a row of the method that drives control.

    Parameters
    ----------
    row : AttitudeRow
        Newest row.
    period_s : float, s
        Expected time to the next one.
    is_innovation_in_band : bool
        Of `is_in_band`; a method without the statistic says True.
    """
    not_acquired = () if row.status is Status.ACQUIRED else (row.status.value.lower(),)
    return RowFacts(
        epoch_us=row.epoch_us,
        period_s=period_s,
        attitude_deg=row.attitude_deg,
        sigma_deg=row.sigma_deg,
        redundancy=row.carriers_used - _UNKNOWNS,
        is_fading=row.downlink_fade,
        is_innovation_in_band=is_innovation_in_band,
        inhibitions=(*row.inhibitions, *not_acquired),
    )


def is_in_band(normalised_square: float, values: float) -> bool:
    """Whether a sum of squared normalised innovations lies within its central 99 %.

    Parameters
    ----------
    normalised_square : float
        Sum over the values; not a number is outside.
    values : float
        Degrees of freedom, > 0.

    Notes
    -----
    Cube root of chi-square is normal (Wilson, Hilferty, PNAS 17, 1931): both ends within 10 % of the exact ones from 6
    degrees on, within 1 % from 40.

    Examples
    --------
    >>> is_in_band(16.0, 16.0), is_in_band(40.0, 16.0), is_in_band(3.0, 16.0)
    (True, False, False)
    """
    if not (values > 0.0 and normalised_square >= 0.0):
        return False
    spread = 2.0 / (9.0 * values)
    root = (normalised_square / values) ** (1.0 / 3.0)
    return bool(abs(root - (1.0 - spread)) <= _QUANTILE * spread**0.5)
