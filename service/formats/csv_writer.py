"""Rows of the archive as CSV: one header line, then one line a row; bytes out, page by page.

Lines and quotes follow RFC 4180. Epochs are RFC 3339 with six decimals, floats the fewest digits that read back to the
stored value, booleans true or false, absent values empty.
"""

from collections.abc import Callable, Sequence

from service.formats.numbers import text_of_float, text_of_float32
from service.records.attitude import AttitudeRow, Exclusion
from service.records.catalogue import Method
from service.records.epoch import format_epoch
from service.records.measurement import Measurement

ATTITUDE_COLUMNS = (
    "epoch",
    "method",
    "yaw_deg",
    "roll_deg",
    "pitch_deg",
    "yaw_sigma_deg",
    "roll_sigma_deg",
    "pitch_sigma_deg",
    "control_allowed",
    "downlink_fade",
    "downlink_fade_db",
    "common_db",
    "carriers_used",
    "excluded",
    "status",
)


def attitude_header() -> bytes:
    """Return the header line of attitude rows."""
    return _line(ATTITUDE_COLUMNS)


def attitude_lines(rows: Sequence[AttitudeRow]) -> bytes:
    """Return one line a row."""
    return b"".join(_attitude_line(row) for row in rows)


class MeasurementCsv:
    """Lines of measurements whose plans may differ: one column for each carrier of any of them.

    Parameters
    ----------
    plans : sequence of sequences of str
        Carrier ids of every plan that occurs; columns stand in the order in which ids first appear.
    carriers_of : callable
        Gives the carrier ids of a plan by its number.
    """

    def __init__(self, plans: Sequence[Sequence[str]], carriers_of: Callable[[int], Sequence[str]]) -> None:
        self._columns = tuple(dict.fromkeys(name for plan in plans for name in plan))
        self._carriers_of = carriers_of
        self._places: dict[int, tuple[int | None, ...]] = {}

    def header(self) -> bytes:
        """Return the header line."""
        return _line(("epoch", "source", *(f"{name}_dbm" for name in self._columns)))

    def lines(self, rows: Sequence[Measurement]) -> bytes:
        """Return one line a row."""
        return b"".join(self._row_line(row) for row in rows)

    def _row_line(self, row: Measurement) -> bytes:
        """Return the line of one row."""
        texts = text_of_float32(row.power_dbm)
        powers = ["" if place is None else texts[place] for place in self._places_of(row.plan_id)]
        return _line((format_epoch(row.epoch_us), row.source, *powers))

    def _places_of(self, plan_id: int) -> tuple[int | None, ...]:
        """Return for each column the place of its carrier in the rows of a plan."""
        if plan_id not in self._places:
            place = {name: k for k, name in enumerate(self._carriers_of(plan_id))}
            self._places[plan_id] = tuple(place.get(name) for name in self._columns)
        return self._places[plan_id]


def _attitude_line(row: AttitudeRow) -> bytes:
    """Return the line of one row."""
    return _line(
        (
            format_epoch(row.epoch_us),
            Method(row.method).value,
            *(text_of_float(value) for value in (*row.attitude_deg, *row.sigma_deg)),
            _truth(row.control_allowed),
            _truth(row.downlink_fade),
            text_of_float(row.downlink_fade_db),
            text_of_float(row.common_db),
            str(row.carriers_used),
            _excluded(row.excluded),
            row.status.value,
        )
    )


def _excluded(exclusions: Sequence[Exclusion]) -> str:
    """Return the carriers left out, each with its reason."""
    return ";".join(f"{item.carrier}:{item.reason}" for item in exclusions)


def _truth(value: bool) -> str:  # noqa: FBT001 the value is what is written
    """Return a boolean as text."""
    return "true" if value else "false"


def _line(fields: Sequence[str]) -> bytes:
    """Return one line of fields."""
    return (",".join(map(_field, fields)) + "\r\n").encode()


def _field(text: str) -> str:
    """Return a field, quoted when it holds what separates fields or lines."""
    if any(mark in text for mark in ',"\r\n'):
        return '"' + text.replace('"', '""') + '"'
    return text
