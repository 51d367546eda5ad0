"""Values that stay in compiled code: a handle goes to and fro in place of the arrays of a state or a model.

A state has some forty arrays, and every one costs on its way into compiled code and out of it. The law of this file: a
handle is a value like the one it holds; nobody writes to either. Imported only where stages are compiled.
"""

from collections.abc import Callable
from typing import Any

from numba.core import types
from numba.experimental import structref

from service.core.estimation.filtering.filter_records import FilterState
from service.core.estimation.filtering.rows.row_stages import ordinary_row


@structref.register
class HeldType(types.StructRef):
    """Type of a handle, by the type of its value."""


class Held(structref.StructRefProxy):
    """Handle of a value."""

    def __new__(cls, value: Any) -> "Held":
        """Return a handle; only compiled code makes one."""
        raise NotImplementedError


structref.define_proxy(Held, HeldType, ["value"])  # type: ignore[no-untyped-call]


def held(value: Any) -> Any:
    """Return a handle of a value; to be compiled."""
    return Held(value)


def row_of_held(digest: str) -> Callable[..., Any]:
    """Return, to be compiled, `ordinary_row` of a model and a state that are held; it also returns a handle after it.

    What changes of a state between rows, Gaussian, drift and figures, is given beside it, like the watch on commands.
    The digest of the sources counts among the marks of kept machine code. Arguments are named one by one: in a tuple
    of all a handle would have the types of the others found out in Python, at every call.
    """

    def run(
        model: Any,
        state: Any,
        gaussian: Any,
        drift: Any,
        beyond_until_us: Any,
        step: Any,
        command: Any,
        drift_deg_h: Any,
        deviation_db: Any,
        present: Any,
    ) -> Any:
        if not digest:
            return None
        kept = state.value
        sensed = FilterState(
            kept.epoch_us,
            gaussian,
            kept.carriers,
            kept.rain,
            kept.noise,
            kept.minute,
            kept.motion,
            kept.model_variance_db2,
            kept.anchor,
            drift,
            command,
            beyond_until_us,
        )
        row = ordinary_row(model.value, sensed, step, command, drift_deg_h, deviation_db, present)
        return row, Held(row.state)

    return run
