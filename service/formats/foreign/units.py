"""Numbers of foreign tables: decimal signs, codes for no reading, units, and what contradicts them."""

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any, Literal

import numpy as np

from service.core.arrays import BoolArray, FloatArray
from service.formats.foreign.table import CODES, NUMBER, ForeignTableError, Table

Decimal = Literal["point", "comma"]
#: unit of a level: its reference, dBm, or None for a power that is no logarithm, with milliwatts in one
LEVEL_UNITS: dict[str, tuple[float | None, float]] = {
    "dBm": (0.0, 0.0),
    "dBW": (30.0, 0.0),
    "mW": (None, 1.0),
    "W": (None, 1e3),
    "uW": (None, 1e-3),
    "nW": (None, 1e-6),
    "pW": (None, 1e-9),
}
_LEVEL_WORDS = {unit.lower(): unit for unit in LEVEL_UNITS} | {"µw": "uW", "μw": "uW", "дбм": "dBm", "дбвт": "dBW"}
#: unit of an angle: degrees in one, and its words
ANGLE_UNITS: dict[str, tuple[float, frozenset[str]]] = {
    "deg": (1.0, frozenset({"deg", "degree", "degrees", "°", "град", "grad"})),
    "mdeg": (1e-3, frozenset({"mdeg", "millideg", "мград"})),
    "rad": (180.0 / np.pi, frozenset({"rad", "radian", "radians", "рад"})),
    "mrad": (0.18 / np.pi, frozenset({"mrad", "мрад"})),
    "urad": (0.18e-3 / np.pi, frozenset({"urad", "µrad", "μrad", "мкрад"})),
    "arcmin": (1 / 60, frozenset({"arcmin"})),
    "arcsec": (1 / 3600, frozenset({"arcsec", "asec"})),
}
_UNIT_IN_NAME = re.compile(r"[\s_\-,;:/]*[\[(]?\s*(dBm|dBW|[mnpuµμ]?W|дБм|дБВт)\s*[\])]?\s*$", re.IGNORECASE)
_PATTERNS: dict[str, str] = {
    "point": r"^[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?$",
    "comma": r"^[+-]?(?:\d+,?\d*|,\d+)(?:[eEdD][+-]?\d+)?$",
}
_WITH_UNIT = rf"^(?P<n>{NUMBER})\s*(?P<u>dBm|dBW|[mnpuµμ]?W|deg|mdeg|°|rad|mrad|arcsec)$"
#: SCPI: not a number, infinity and its negative
_NO_NUMBER = 9.89e37
#: keeps the sum of 30 and a decimal a decimal, dB
_SUM_DECIMALS = 9
#: no level of a carrier is a positive number below it, dBm
_TINY = 0.05
#: angles all below it are those of no sensor, deg
_STILL_DEG = 2e-4
#: rows from which a column that never changes is no measurement
_CONSTANT_ROWS = 20


def number_column(texts: Any, decimal: str, missing: Sequence[str]) -> tuple[FloatArray, BoolArray, str | None]:
    """Return the numbers of a column of texts, NaN = absent, which cells are neither, and their unit."""
    import pyarrow as pa
    import pyarrow.compute as pc

    if decimal == "point" and not missing:
        with suppress(pa.ArrowInvalid):
            is_empty = pc.equal(texts, "")
            plain = pc.if_else(is_empty, "nan", texts) if pc.any(is_empty).as_py() else texts
            values = plain.cast(pa.float64()).to_numpy().copy()
            values[~(np.abs(values) < _NO_NUMBER)] = np.nan
            return values, np.zeros(len(values), dtype=np.bool_), None
    unit = None
    is_number = pc.match_substring_regex(texts, pattern=_PATTERNS[decimal])
    low = pc.utf8_lower(texts)
    codes = pa.array([*CODES, *(each.strip().casefold() for each in missing)])
    # a limit is no reading: <-80
    is_code = pc.or_(pc.is_in(low, codes), pc.match_substring_regex(texts, pattern=r"^[<>≤≥]=?\s?[+-]?\d"))
    if not pc.any(is_number).as_py():
        parts = pc.extract_regex(texts, pattern=_WITH_UNIT)
        found = pc.unique(pc.struct_field(parts, "u").drop_null()).to_pylist()
        if len(found) == 1:
            texts = pc.if_else(parts.is_valid(), pc.struct_field(parts, "n"), texts)
            is_number, unit = pc.match_substring_regex(texts, pattern=_PATTERNS[decimal]), found[0]
            unit = _LEVEL_WORDS.get(unit.lower(), "deg" if unit == "°" else unit)
    plain = pc.if_else(is_number, texts, "nan")
    plain = pc.replace_substring_regex(pc.replace_substring(plain, ",", "."), pattern="[dD]", replacement="e")
    values = plain.cast(pa.float64()).to_numpy(zero_copy_only=False).copy()
    values[np.abs(values) >= _NO_NUMBER] = np.nan
    for each in missing:
        try:
            values[values == float(each.replace(",", "."))] = np.nan
        except ValueError:
            continue
    is_bad = ~np.asarray(pc.or_(is_code, is_number).to_numpy(zero_copy_only=False), dtype=np.bool_)
    return values, is_bad, unit


def decimal_of(table: Table) -> Decimal:
    """Return the decimal sign of the numbers of a table; ForeignTableError when there are two."""
    import pyarrow.compute as pc

    signs: dict[Decimal, str] = {}
    marks: tuple[tuple[Decimal, str], ...] = (("comma", ","), ("point", "."))
    for name, column in zip(table.header, table.columns, strict=True):
        some = column[:: max(1, len(column) // 2000)] if len(column) > 4000 else column
        held = pc.sum(pc.not_equal(some, "")).as_py() or 0
        for decimal, mark in marks:
            pattern = rf"^[+-]?\d*\{mark}\d+(?:[eE][+-]?\d+)?\s*(?:dBm|dBW|\pL?W|deg|°)?$"
            if held and (pc.sum(pc.match_substring_regex(some, pattern=pattern)).as_py() or 0) > 0.1 * held:
                signs.setdefault(decimal, name)
    if len(signs) > 1:
        shown = " and ".join(f"{decimal} in {name!r}" for decimal, name in signs.items())
        raise ForeignTableError(f"decimals of two kinds: {shown}; write all numbers alike, or state decimal")
    return next(iter(signs), "point")


def level_unit(name: str, units: Mapping[str, str]) -> str | None:
    """Return the unit of a column of levels that its name or the unit row states.

    Examples
    --------
    >>> level_unit("Ch 1 [dBm]", {}), level_unit("c00_dbw", {}), level_unit("level", {})
    ('dBm', 'dBW', None)
    """
    if (row := units.get(name, "").lower()) in _LEVEL_WORDS:
        return _LEVEL_WORDS[row]
    found = _UNIT_IN_NAME.search(name)
    # a name that ends with a plain w is no power: flow, now
    if found is None or (found.group(0) == found.group(1) and len(found.group(1)) <= 2):
        return None
    return _LEVEL_WORDS.get(found.group(1).lower())


def without_unit(name: str) -> str:
    """Return a column's name without its unit."""
    return _UNIT_IN_NAME.sub("", name).strip() if level_unit(name, {}) else name.strip()


def angle_unit(name: str, units: Mapping[str, str]) -> str | None:
    """Return the unit of a column of angles that its name or the unit row states."""
    words = {word.casefold() for word in re.findall(r"[^\W\d_]+|°", f"{name} {units.get(name, '')}")}
    found = [unit for unit, (_, known) in ANGLE_UNITS.items() if words & known]
    return found[0] if len(found) == 1 else None


def levels_dbm(raw: FloatArray, units: Sequence[str]) -> FloatArray:
    """Return levels in dBm (T, N) of numbers in the unit of each column; a power of 0 or less has none."""
    columns = []
    for column, unit in zip(raw.T, units, strict=True):
        offset_db, milliwatts = LEVEL_UNITS[unit]
        if offset_db is None:
            with np.errstate(divide="ignore", invalid="ignore"):
                columns.append(np.where(column > 0.0, 10.0 * np.log10(column * milliwatts), np.nan))
        else:
            columns.append(np.round(column + offset_db, _SUM_DECIMALS) if offset_db else column)
    return np.column_stack(columns)


def contradicted_level_unit(raw: FloatArray, units: Sequence[str | None]) -> tuple[str, str] | None:
    """Return why the numbers are not of the units that names state, and the likely unit; None: they may be."""
    for column, unit in zip(raw.T, units, strict=True):
        held = column[np.isfinite(column)]
        if unit is None or not len(held):
            continue
        if unit.startswith("dB") and held.min() > 0.0 and held.max() < _TINY:
            return f"the name says {unit}, the values are all positive and tiny", "mW"
        if not unit.startswith("dB") and np.median(held) < 0.0:
            return f"the name says {unit}, the values are negative", "dBm"
    return None


def contradicted_angle_unit(
    raw: FloatArray, axes: Sequence[str], units: Sequence[str | None], disc_deg: float
) -> tuple[str, str] | None:
    """Return why the numbers are not of the stated unit, and the likely unit; None: they may be."""
    held = [k for k, axis in enumerate(axes) if axis != "yaw"] or list(range(len(axes)))
    unit = units[held[0]] or "deg"
    size = np.abs(raw[:, held])
    size = np.minimum(size, np.abs(360.0 / ANGLE_UNITS[unit][0] - size))
    if not np.isfinite(size).any():
        return None
    middle, greatest = float(np.nanmedian(size)), float(np.nanmax(np.abs(raw)))
    fitting = [each for each, (scale, _) in ANGLE_UNITS.items() if middle * scale < disc_deg / 4]
    if middle * ANGLE_UNITS[unit][0] > disc_deg and fitting:
        return f"under {unit} the angles, in the middle {middle:g}, lie beyond the Earth's disc", fitting[0]
    if 0.0 < greatest * ANGLE_UNITS[unit][0] < _STILL_DEG:
        return f"under {unit} no angle reaches {_STILL_DEG:g} deg: is that the unit?", "deg"
    return None


def suspected_codes(raw: FloatArray, least_gap: float, *, has_zero_rows: bool) -> dict[float, int]:
    """Return numbers that repeat apart from all others of their column, with how often: likely codes for no reading.

    Parameters
    ----------
    raw : ndarray, shape (T, N)
        Numbers of the columns, NaN = absent.
    least_gap : float
        Least distance to the others, in the unit of the numbers.
    has_zero_rows : bool
        Rows that are zero in all columns are judged too.
    """
    found: dict[float, int] = {}
    for column in raw.T:
        held = column[np.isfinite(column)]
        values, counts = np.unique(held, return_counts=True)
        if len(values) == 1 and len(held) >= _CONSTANT_ROWS:
            found[float(values[0])] = found.get(float(values[0]), 0) + len(held)
        # several codes may stand at one end
        for _ in range(4):
            if len(values) < 3:
                break
            ends = [(values[1] - values[0], 0), (values[-1] - values[-2], len(values) - 1)]
            gap, end = max(ends)
            rest = np.delete(values, end)
            spread = float(np.subtract(*np.percentile(np.repeat(rest, np.delete(counts, end)), [98, 2])))
            if counts[end] < 2 or gap < max(least_gap, 3.0 * spread):
                break
            found[float(values[end])] = found.get(float(values[end]), 0) + int(counts[end])
            values, counts = rest, np.delete(counts, end)
    if has_zero_rows and raw.shape[1] > 1:
        zeros = int(np.sum(np.all(raw == 0.0, axis=1)))
        if 3 <= zeros < len(raw):
            found.setdefault(0.0, zeros)
    return found
