"""Rows and samples of the service as arrays with units: numpy, and pandas or xarray (extra ``soo[analysis]``).

Columns carry the names of the contract, whose ends are their units. A member of several values becomes one column for
each of them: ``sigma_deg`` of yaw is ``yaw_sigma_deg``, ``power_dbm`` of carrier c00 is ``c00_power_dbm``. Absent
is NaN; a number that no row has gives no column, except the angles.
"""

import importlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from service.records.epoch import format_epoch, parse_epoch
from service.records.levels.attitude import FloatArray
from service.records.setting import unit_of

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

#: in the order of the turns
_AXES = ("yaw_deg", "pitch_deg", "roll_deg")


@dataclass(frozen=True, slots=True)
class SeriesArrays:
    """Columns of numbers over instants.

    Parameters
    ----------
    epochs_us : ndarray of int64, shape (T,)
        Microseconds UTC.
    columns : mapping of str to ndarray, shape (T,)
        By name; NaN = absent.
    attributes : mapping of str to str
        What all rows have in common, such as method and version.
    """

    epochs_us: NDArray[np.int64]
    columns: Mapping[str, FloatArray]
    attributes: Mapping[str, str] = field(default_factory=dict)

    @property
    def epochs(self) -> NDArray[np.datetime64]:
        """Instants as datetime64[us], UTC, shape (T,)."""
        return self.epochs_us.view("datetime64[us]")

    @property
    def units(self) -> dict[str, str]:
        """Units of the columns that have one."""
        return {name: unit for name in self.columns if (unit := unit_of(name)) is not None}

    def complete(self, *names: str) -> "SeriesArrays":
        """Return the rows in which all these columns have a value.

        Raises
        ------
        KeyError
            There is no such column.
        """
        held = np.all([np.isfinite(self.columns[name]) for name in names], axis=0)
        columns = {name: column[held] for name, column in self.columns.items()}
        return SeriesArrays(self.epochs_us[held], columns, self.attributes)

    def rotations(self) -> "Rotation":
        """Return the attitudes as T rotations: applied to vectors of the body they give those of the nadir frame.

        The nadir frame has x East, y South, z to the Earth's centre; the body is turned by yaw about z, then pitch
        about the new y, then roll about the new x. ``inv()`` applied to vectors of the nadir frame gives those of the
        body.

        Raises
        ------
        ValueError
            A row has no attitude.
        """
        from scipy.spatial.transform import Rotation

        angles_deg = np.stack([self.columns[name] for name in _AXES], axis=-1)
        absent = np.flatnonzero(~np.isfinite(angles_deg).all(axis=-1))
        if absent.size:
            first = format_epoch(int(self.epochs_us[absent[0]]))
            message = f"{absent.size} rows have no attitude, the first at {first}; call complete{_AXES} first"
            raise ValueError(message)
        return Rotation.from_euler("ZYX", angles_deg, degrees=True)

    def to_pandas(self) -> Any:
        """Return a data frame over instants in UTC; ``attrs`` holds units and attributes. Needs pandas."""
        pandas = _of_extra("pandas")
        index = pandas.DatetimeIndex(self.epochs, name="epoch").tz_localize("UTC")
        frame = pandas.DataFrame(dict(self.columns), index=index)
        frame.attrs = {**self.attributes, "units": self.units}
        return frame

    def to_xarray(self) -> Any:
        """Return a data set over instants in UTC; each variable has its unit, the set the attributes. Needs xarray."""
        xarray, units = _of_extra("xarray"), self.units
        variables = {
            name: ("epoch", column, {"units": units[name]} if name in units else {})
            for name, column in self.columns.items()
        }
        epochs = ("epoch", self.epochs, {"time_system": "UTC"})
        return xarray.Dataset(variables, {"epoch": epochs}, dict(self.attributes))


def table_of_rows(rows: Iterable[Mapping[str, Any]]) -> SeriesArrays:
    """Return the numbers of rows of a history, such as `attitude_history` yields them.

    Words that all rows share, such as method and version, become attributes; other words and lists are left out.
    """
    held = list(rows)
    numbers = [dict(_numbers(row)) for row in held]
    names = dict.fromkeys(name for row in numbers for name in row)
    columns = {name: np.array([row.get(name, np.nan) for row in numbers], dtype=np.float64) for name in names}
    words = {name for row in held for name, value in row.items() if isinstance(value, str)} - {"epoch", "received_at"}
    shared = {name: {row.get(name) for row in held} for name in sorted(words)}
    attributes = {name: str(values.pop()) for name, values in shared.items() if len(values) == 1}
    return SeriesArrays(_microseconds(row["epoch"] for row in held), columns, attributes)


def table_of_samples(samples: Mapping[str, Any], statistic: Literal["avg", "min", "max"] = "avg") -> SeriesArrays:
    """Return one statistic of each series of `samples`; method or carrier stand before the name of the quantity."""
    columns = {
        "_".join(filter(None, (series["method"], series["carrier"], series["quantity"]))): np.array(
            [np.nan if value is None else value for value in series[statistic]], dtype=np.float64
        )
        for series in samples["series"]
    }
    attributes = {"statistic": statistic, "version": str(samples["version"]), "interval_s": str(samples["interval_s"])}
    return SeriesArrays(_microseconds(samples["epochs"]), columns, attributes)


def _numbers(row: Mapping[str, Any]) -> Iterator[tuple[str, float]]:
    """Yield name and value of each number of a row, those of members with several values too."""
    for name, value in row.items():
        if isinstance(value, Mapping):
            yield from ((f"{inner}_{name}", number) for inner, number in value.items() if _is_number(number))
        elif _is_number(value) or name in _AXES:
            yield name, np.nan if value is None else value


def _is_number(value: Any) -> bool:
    """Return whether a value is a number; a truth value is not."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def _microseconds(epochs: Iterable[str]) -> NDArray[np.int64]:
    return np.array([parse_epoch(epoch) for epoch in epochs], dtype=np.int64)


def _of_extra(name: str) -> Any:
    """Return a package of the extra; ModuleNotFoundError says what to install."""
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        message = f"{name} is not installed; pip install soo[analysis]"
        raise ModuleNotFoundError(message, name=name) from error
