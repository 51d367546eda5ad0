"""One figure beside what was printed for it."""

import math
from typing import NamedTuple


class Compared(NamedTuple):
    """A figure of the reference and the one reproduced."""

    case: str
    figure: str
    reference: float
    found: float
    tolerance: float
    #: the tolerance is a share of the reference; otherwise a distance
    is_relative: bool = True

    @property
    def ratio(self) -> float:
        """Return found over reference; 1 where both are equal, zero or infinite included."""
        if self.found == self.reference:
            return 1.0
        return self.found / self.reference if self.reference != 0.0 else math.inf

    @property
    def is_kept(self) -> bool:
        """Return whether the figure is within its tolerance; NaN never is."""
        if self.found == self.reference:
            return True
        allowed = self.tolerance * abs(self.reference) if self.is_relative else self.tolerance
        return abs(self.found - self.reference) <= allowed


class ComparedTable(NamedTuple):
    """One table of the reference."""

    name: str
    title: str
    rows: tuple[Compared, ...]


def holds(case: str, claim: str, *, is_true: bool) -> Compared:
    """Return a claim as a figure: 1 where it holds."""
    return Compared(case, claim, 1.0, float(is_true), 0.0, is_relative=False)
