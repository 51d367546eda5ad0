"""``soo compare``: two versions of the attitude history row by row.

Rows belong together that have the same epoch, the first of one epoch with the first, and so on.
"""

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from service.cli.command_group import end, require
from service.cli.operation import connection
from service.records.epoch import format_epoch, parse_epoch
from service.records.levels.attitude import FloatArray, IntArray

if TYPE_CHECKING:
    from service.client.service_client import ServiceClient


AXES = ("yaw", "roll", "pitch")


@dataclass(frozen=True, slots=True)
class VersionRows:
    """Rows (T,) of one version in order of epoch; the k-th row of an epoch is named by k."""

    version: str
    epochs_us: IntArray
    names: tuple[tuple[int, int], ...]
    #: (T, 3) yaw, roll, pitch, deg; NaN where a row has none
    angles_deg: FloatArray
    sigma_deg: FloatArray
    protection_deg: FloatArray
    is_allowed: NDArray[np.bool_]
    inhibitions: tuple[tuple[str, ...], ...]


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


def rows_of(version: str, answers: Iterable[Mapping[str, Any]]) -> VersionRows:
    """Return the answers of ``GET attitude/history`` as arrays."""
    seen: Counter[int] = Counter()
    names: list[tuple[int, int]] = []
    numbers: list[list[float | None]] = []
    is_allowed: list[bool] = []
    inhibitions: list[tuple[str, ...]] = []
    for row in answers:
        epoch_us = parse_epoch(row["epoch"])
        names.append((epoch_us, seen[epoch_us]))
        seen[epoch_us] += 1
        angles = [row[f"{axis}_deg"] for axis in AXES]
        numbers.append([*angles, *(row[what][axis] for what in ("sigma_deg", "protection_deg") for axis in AXES)])
        is_allowed.append(row["control_allowed"])
        inhibitions.append(tuple(row["inhibitions"]))
    angles_deg, sigma_deg, protection_deg = np.split(np.array(numbers, dtype=float).reshape(-1, 9), 3, axis=1)
    epochs_us = np.array([epoch_us for epoch_us, _ in names], dtype=np.int64)
    allowed = np.array(is_allowed, dtype=np.bool_)
    return VersionRows(
        version, epochs_us, tuple(names), angles_deg, sigma_deg, protection_deg, allowed, tuple(inhibitions)
    )


def compared(first: VersionRows, second: VersionRows) -> Comparison:
    """Return two versions side by side."""
    position_of = {name: position for position, name in enumerate(second.names)}
    shared = [(k, position_of[name]) for k, name in enumerate(first.names) if name in position_of]
    positions = np.array(shared, dtype=np.int64).reshape(-1, 2)
    return Comparison(first, second, positions[:, 0], positions[:, 1])


def document_of(found: Comparison) -> dict[str, Any]:
    """Return the figures of a comparison: those of rows that both have, and what each one has alone."""
    shared = len(found.in_first)
    difference_deg = found.difference_deg
    sides = ((found.first, found.in_first), (found.second, found.in_second))
    counts = [Counter(code for k in chosen for code in side.inhibitions[k]) for side, chosen in sides]
    return {
        "versions": [side.version for side, _ in sides],
        "rows": {
            "both": shared,
            "first_alone": len(found.first.names) - shared,
            "second_alone": len(found.second.names) - shared,
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


_LIVE = "live"


def compare(
    first: Annotated[str, typer.Argument(help="Version: `live`, or `replay-1` and so on.")],
    second: Annotated[str, typer.Argument(help="The other version; differences are this one minus the first.")],
    spacecraft: connection.SpacecraftOption,
    start: Annotated[str | None, typer.Option(help="From here, RFC 3339; default: where both spans begin.")] = None,
    stop: Annotated[str | None, typer.Option(help="To here, exclusive; default: where the first span ends.")] = None,
    method: Annotated[str, typer.Option(help="`robust` or `paper`.")] = "robust",
    figure: Annotated[Path | None, typer.Option(help="Draw the differences into this PNG or SVG file.")] = None,
    service: connection.ServiceUrl = connection.DEFAULT_SERVICE,
    key_env: connection.KeyEnvironment = connection.DEFAULT_KEY_ENVIRONMENT,
    as_json: connection.JsonOption = False,
) -> None:
    """Compare the attitude of two versions row by row."""
    if first == second:
        end(f"{first} is compared with itself; name two versions")
    if figure is not None:
        require("matplotlib")
    # numpy costs more than the command line itself

    with connection.connected(service, key_env) as client:
        span = _span(client, spacecraft, (first, second), start, stop)
        found = compared(
            *(
                rows_of(one, client.attitude_history(spacecraft, *span, method=method, version=one))
                for one in (first, second)
            )
        )
    named = f"{spacecraft}, {method}: {second} minus {first}, {span[0]} to {span[1]}"
    if not len(found.in_first):
        counts = [len(found.first.names), len(found.second.names)]
        end(f"{named}: no row in both, {first} has {counts[0]} and {second} has {counts[1]}; look at `soo replays`", 1)
    document = {"spacecraft": spacecraft, "method": method, "start": span[0], "stop": span[1], **document_of(found)}
    if figure is not None:
        try:
            draw_comparison(found, named, figure)
        except (OSError, ValueError) as error:
            end(f"the figure cannot be written: {error}", cause=error)
    typer.echo(json.dumps(document, allow_nan=False) if as_json else f"{named}\n{_table(document)}")


def _span(
    client: "ServiceClient", spacecraft: str, versions: tuple[str, ...], start: str | None, stop: str | None
) -> tuple[str, str]:
    """Return the span that is compared: that of the options, else what the replays have in common."""
    replays = []
    for version in versions:
        number = version.removeprefix("replay-")
        if version == _LIVE:
            continue
        if version == number or not (number.isascii() and number.isdecimal()):
            end(f"{version} is no version; name `live` or `replay-` with a number, see `soo replays`")
        replays.append(client.replay(spacecraft, int(number)))
    # texts of one form: the service writes every epoch alike
    start = start or max((each["start"] for each in replays), default=None)
    stop = stop or min((each["stop"] for each in replays), default=None)
    if start is None or stop is None:
        end("nothing says which span is compared; state --start and --stop")
    return start, stop


def _table(document: dict[str, Any]) -> str:
    """Return the figures as lines."""
    rows, (first, second) = document["rows"], document["versions"]
    lines = [
        f"rows: {rows['both']} in both ({rows['both_with_angles']} with angles), {rows['first_alone']} in {first} "
        f"alone, {rows['second_alone']} in {second} alone"
    ]
    for axis, each in document["difference_deg"].items():
        sigma, level = document["rms_sigma_deg"][axis], document["median_protection_deg"][axis]
        lines.append(
            f"{axis:<6} rms {_number(each['rms'])}, greatest {_number(each['greatest'])} deg at "
            f"{each['greatest_at'] or '-'}; sigma {_pair(sigma)}; protection level {_pair(level)} deg"
        )
    lines.append(f"control allowed: {_pair(document['control_allowed'])} of the rows")
    lines += [f"{code}: {counts[0]} -> {counts[1]} rows" for code, counts in document["inhibitions"].items()]
    return "\n".join(lines)


def _pair(values: list[float | None]) -> str:
    return " -> ".join(map(_number, values))


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f}"


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
