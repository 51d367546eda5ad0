"""Published figures and statements beside what the product makes of them, one row each."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

COLUMNS = ("figure", "parameters", "paper", "reproduced", "ratio", "verdict")


class Agreement(StrEnum):
    """Agreement of a reproduced figure with the published one."""

    #: equal within the rounding of the print, within a stated bound, or as the print says in words
    REPRODUCED = "reproduced"
    #: meets a bound or a figure to which parameters were chosen
    FITTED = "fitted"
    NOT_REPRODUCED = "not reproduced"


@dataclass(frozen=True, slots=True)
class Row:
    """One published figure, or a statement without one."""

    what: str
    parameters: str
    #: None: the print says it in words
    published: float | None
    #: the print gives an upper bound
    is_bound: bool
    reproduced: float
    unit: str
    verdict: Agreement
    #: the print in words
    statement: str = ""
    #: not reproduced, and the page of the study says why
    is_known_miss: bool = False
    #: that are shown of the reproduced figure
    digits: int = 4

    @property
    def ratio(self) -> float | None:
        """Reproduced over published; None without a published figure. Both may be infinite."""
        if not self.published:
            return None
        return 1.0 if self.reproduced == self.published else self.reproduced / self.published

    @property
    def is_surprising(self) -> bool:
        """Return whether a figure does not reproduce that should."""
        return self.verdict is Agreement.NOT_REPRODUCED and not self.is_known_miss

    @property
    def cells(self) -> tuple[str, ...]:
        """Return the row as the cells of a line."""
        unit = f" {self.unit}" if self.unit else ""
        bound = "<= " if self.is_bound else ""
        figure = "" if self.published is None else f"{bound}{self.published:.{max(6, self.digits)}g}{unit}"
        ratio = "-" if self.ratio is None else f"{self.ratio:.{self.digits - 2}f}"
        found = f"{self.reproduced:.{self.digits}g}{unit}"
        return (self.what, self.parameters, figure or self.statement, found, ratio, self.verdict.value)

    def document(self) -> dict[str, Any]:
        """Return the row fit for JSON; infinite and missing numbers are null."""
        members = {**asdict(self), "ratio": self.ratio}
        return {
            name: None if isinstance(value, float) and not math.isfinite(value) else value
            for name, value in members.items()
        }


def row(
    what: str,
    parameters: str,
    published: float,
    reproduced: float,
    unit: str,
    *,
    is_bound: bool = False,
    within: float = 0.0,
    is_fitted: bool = False,
    is_known_miss: bool = False,
    digits: int = 4,
) -> Row:
    """Return the row of a published figure; ``within`` is the rounding of the print or the error to be expected."""
    is_met = reproduced <= published if is_bound else abs(reproduced - published) <= within
    # both may be infinite
    is_met = is_met or reproduced == published
    met = Agreement.FITTED if is_fitted else Agreement.REPRODUCED
    verdict = met if is_met else Agreement.NOT_REPRODUCED
    return Row(
        what, parameters, published, is_bound, reproduced, unit, verdict, is_known_miss=is_known_miss, digits=digits
    )


def statement_row(
    what: str,
    parameters: str,
    statement: str,
    reproduced: float,
    unit: str,
    *,
    is_met: bool,
    is_fitted: bool = False,
    is_known_miss: bool = False,
) -> Row:
    """Return the row of a statement that the print makes in words."""
    met = Agreement.FITTED if is_fitted else Agreement.REPRODUCED
    verdict = met if is_met else Agreement.NOT_REPRODUCED
    return Row(what, parameters, None, False, reproduced, unit, verdict, statement, is_known_miss)


def markdown(tables: Mapping[str, Sequence[Row]]) -> str:
    """Return tables as sections of a page; a single one stands without its title."""
    lines = []
    for title, rows in tables.items():
        lines += [f"### {title}", ""] if len(tables) > 1 else []
        lines += [f"| {' | '.join(COLUMNS)} |", f"|{'---|' * len(COLUMNS)}"]
        lines += [*(f"| {' | '.join(one.cells)} |" for one in rows), ""]
    return "\n".join(lines)
