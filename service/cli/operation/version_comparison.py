"""Comparison of two versions of attitude rows of one method: differences, sigmas, inhibitions, and their figure."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyarrow import parquet

from service.records.epoch import format_epoch
from service.records.levels.attitude import FloatArray, IntArray

AXES = ("yaw", "roll", "pitch")


@dataclass(frozen=True, slots=True)
class VersionRows:
    """Rows (T,) of one version in order of epoch."""

    version: str
    epochs_us: IntArray
    #: (T,) k of the k-th row of an epoch
    places: IntArray
    #: (T, 3) yaw, roll, pitch, deg; NaN where a row has none
    angles_deg: FloatArray
    sigma_deg: FloatArray
    protection_deg: FloatArray
    is_allowed: NDArray[np.bool_]
    #: (T,) their codes, joined by semicolons
    inhibitions: NDArray[np.object_]


@dataclass(frozen=True, slots=True)
class Comparison:
    """Two versions, and the positions (S,) in each of the rows that both have."""

    first: VersionRows
    second: VersionRows
    in_first: IntArray
    in_second: IntArray

    @property
    def difference_deg(self) -> FloatArray:
        """Return the angles of the second minus those of the first (S, 3); NaN where one has none."""
        return self.second.angles_deg[self.in_second] - self.first.angles_deg[self.in_first]


def rows_of(version: str, export: Iterable[bytes]) -> VersionRows:
    """Return the rows of a Parquet file of ``GET archive/attitude:export``, which comes in pieces, as arrays."""
    figures = [f"{axis}_{what}" for what in ("deg", "sigma_deg", "protection_deg") for axis in AXES]
    with TemporaryFile() as file:
        file.writelines(export)
        table: Any = parquet.read_table(file, columns=["epoch", *figures, "control_allowed", "inhibitions"])
    epochs_us = table["epoch"].to_numpy().astype("datetime64[us]").astype(np.int64)
    places = np.arange(len(epochs_us)) - np.searchsorted(epochs_us, epochs_us)
    values = np.array([table[name].to_numpy() for name in figures], dtype=float)
    angles_deg, sigma_deg, protection_deg = np.split(values.T, 3, axis=1)
    is_allowed, inhibitions = (table[name].to_numpy() for name in ("control_allowed", "inhibitions"))
    return VersionRows(version, epochs_us, places, angles_deg, sigma_deg, protection_deg, is_allowed, inhibitions)


def compared(first: VersionRows, second: VersionRows) -> Comparison:
    """Return two versions side by side."""
    sides = (first, second)
    if not all(side.epochs_us.size for side in sides):
        return Comparison(first, second, np.empty(0, np.int64), np.empty(0, np.int64))
    begin_us = min(side.epochs_us[0] for side in sides)
    most = 1 + max(side.places.max() for side in sides)
    keys = [(side.epochs_us - begin_us) * most + side.places for side in sides]
    _, *positions = np.intersect1d(keys[0], keys[1], assume_unique=True, return_indices=True)
    return Comparison(first, second, positions[0], positions[1])


def document_of(found: Comparison) -> dict[str, Any]:
    """Return the figures of a comparison: those of rows that both have, and what each one has alone."""
    shared = len(found.in_first)
    difference_deg = found.difference_deg
    sides = ((found.first, found.in_first), (found.second, found.in_second))
    counts = [_codes(side.inhibitions[chosen]) for side, chosen in sides]
    return {
        "versions": [side.version for side, _ in sides],
        "rows": {
            "both": shared,
            "first_alone": len(found.first.epochs_us) - shared,
            "second_alone": len(found.second.epochs_us) - shared,
            "both_with_angles": int(np.isfinite(difference_deg).all(axis=1).sum()),
        },
        "difference_deg": {
            axis: _difference(difference_deg[:, k], found.first.epochs_us[found.in_first])
            for k, axis in enumerate(AXES)
        },
        "rms_sigma_deg": _by_axis([side.sigma_deg[chosen] for side, chosen in sides], _rms),
        "median_protection_deg": _by_axis([side.protection_deg[chosen] for side, chosen in sides], _median),
        "control_allowed": [_share(side.is_allowed[chosen]) for side, chosen in sides],
        "inhibitions": {code: [count[code] for count in counts] for code in sorted(counts[0] | counts[1])},
    }


def _codes(inhibitions: NDArray[np.object_]) -> Counter[str]:
    """Return how many rows each code inhibits."""
    counts: Counter[str] = Counter()
    for codes, rows in Counter(inhibitions).items():
        counts.update(dict.fromkeys(filter(None, codes.split(";")), rows))
    return counts


def _difference(difference_deg: FloatArray, epochs_us: IntArray) -> dict[str, Any]:
    """Return root mean square, greatest size and its epoch of the differences (S,) in one axis."""
    if not np.isfinite(difference_deg).any():
        return {"rms": None, "greatest": None, "greatest_at": None}
    greatest = int(np.nanargmax(np.abs(difference_deg)))
    return {
        "rms": _rms(difference_deg),
        "greatest": float(difference_deg[greatest]),
        "greatest_at": format_epoch(int(epochs_us[greatest])),
    }


def _by_axis(sides: list[FloatArray], figure: Any) -> dict[str, list[float | None]]:
    return {axis: [figure(values[:, k]) for values in sides] for k, axis in enumerate(AXES)}


def _rms(values: FloatArray) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else None


def _median(values: FloatArray) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else None


def _share(is_so: NDArray[np.bool_]) -> float | None:
    return float(is_so.mean()) if is_so.size else None


def draw_comparison(found: Comparison, title: str, path: Path) -> None:
    """Draw the differences of a comparison into a PNG or SVG file, between three sigmas of both together."""
    # matplotlib costs half a second that a comparison without a figure need not pay
    import matplotlib as mpl
    from matplotlib.figure import Figure

    epochs = found.first.epochs_us[found.in_first].astype("datetime64[us]")
    difference_deg = found.difference_deg
    sigma_deg = np.hypot(found.first.sigma_deg[found.in_first], found.second.sigma_deg[found.in_second])
    with mpl.rc_context({"font.size": 9, "axes.grid": True, "grid.alpha": 0.3, "date.converter": "concise"}):
        figure = Figure(figsize=(9.0, 6.5), layout="constrained")
        for k, (axes, axis) in enumerate(zip(figure.subplots(3, 1, sharex=True), AXES, strict=True)):
            band = 3.0 * sigma_deg[:, k]
            axes.fill_between(
                epochs, -band, band, color="#999999", alpha=0.3, linewidth=0, label="three sigmas of both"
            )
            axes.plot(epochs, difference_deg[:, k], color="#1f77b4", linewidth=0.8, label="difference")
            axes.set_ylabel(f"{axis}, deg")
        axes.set_xlabel("UTC")
        axes.legend(loc="upper right", ncols=2, frameon=False)
        figure.suptitle(title)
        figure.savefig(path, dpi=120)
