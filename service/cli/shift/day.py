"""Figures of a span: samples of angles and protection levels, drawn and summed up, and what happened in it."""

import io
from datetime import datetime
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from service.cli.shift.pages import operation_line
from service.cli.shift.tables import AXES, clean, meaning, number, utc, words
from service.client.documents import Json

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.client.service_client import ServiceClient

#: intervals of a span
_COUNT = 480
_KINDS = ("deg", "sigma_deg", "protection_deg")


def samples_of(client: "ServiceClient", spacecraft: str, wanted: Json) -> Json:
    """Return samples of a span and a method."""
    quantities = [f"{axis}_{kind}" for axis in AXES for kind in _KINDS] + ["control_allowed", "downlink_fade_db"]
    params = {**wanted, "quantity": quantities, "count": _COUNT}
    return Json(client.request("GET", f"/spacecraft/{spacecraft}/samples", params=params))


def figures(samples: Json) -> list[str]:
    """Return rows, share of control, and the range of each angle as lines."""
    allowed = next(each for each in samples["series"] if each["quantity"] == "control_allowed")
    rows = sum(allowed["n"])
    if not rows:
        return [words("views.history.empty")]
    share = np.dot(allowed["n"], [each or 0.0 for each in allowed["avg"]]) / rows
    # whole intervals: the first may begin some minutes before the span of the report
    since = utc(samples["range"]["start"])
    lines = [f"{rows} rows since {since}; the estimate allowed control in {share:.1%} of them"]
    for axis in AXES:
        least, greatest = _column(samples, f"{axis}_deg", "min"), _column(samples, f"{axis}_deg", "max")
        protection = _column(samples, f"{axis}_protection_deg", "max")
        lines.append(
            f"{words(f'app.axis.{axis}')}: {_end(least, -1)} to {_end(greatest, 1)} deg; "
            f"{words('views.now.protection')} at most {_end(protection, 1)} deg"
        )
    fade = _column(samples, "downlink_fade_db", "max")
    return [*lines, f"{words('views.now.fade')}: at most {_end(fade, 1)} dB"]


def drawn(samples: Json) -> bytes:
    """Return the angles with two sigma, and the protection levels, as PNG."""
    # matplotlib places instants without a zone on its axis as UTC
    epochs = [datetime.fromisoformat(each).replace(tzinfo=None) for each in samples["epochs"]]
    with mpl.rc_context({"font.size": 9, "axes.grid": True, "grid.alpha": 0.3}):
        figure = Figure(figsize=(9.0, 7.5), layout="constrained")
        *panels, lowest = figure.subplots(4, 1, sharex=True)
        for axis, panel in zip(AXES, panels, strict=True):
            angle, sigma = _column(samples, f"{axis}_deg", "avg"), _column(samples, f"{axis}_sigma_deg", "avg")
            panel.fill_between(epochs, angle - 2 * sigma, angle + 2 * sigma, alpha=0.25, linewidth=0)
            panel.plot(epochs, angle, linewidth=1.0)
            panel.set_ylabel(f"{axis}, deg")
            lowest.plot(epochs, _column(samples, f"{axis}_protection_deg", "max"), linewidth=1.0, label=axis)
        lowest.set(ylabel="protection level, deg", xlabel="UTC")
        # above its panel: inside, it covers a curve
        lowest.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False)
        picture = io.BytesIO()
        figure.savefig(picture, format="png", dpi=100)
    return picture.getvalue()


def happened(timeline: Json) -> list[str]:
    """Return alarms, commands, operations, gaps and exclusions of a span in order of time, as lines."""
    events = [
        (each["raised_at"], f"{meaning('alarms', each['condition'])} {clean(each['thing'])}")
        for each in timeline["alarms"]
    ]
    for each in timeline["commands"]:
        said = f"{each['id']}, {meaning('commands', each['state'])}: {clean(each['reason'])}"
        events.append((each["prepared_at"], f"Command {said}; {clean(each['prepared_by'])}"))
    events += [(each["start"], operation_line(each)) for each in timeline["operations"]]
    for each in timeline["states"]:
        if each["kind"] == "exclusion":
            said = f"{clean(each['carrier'])}: {meaning('exclusions', each['name'])}"
            events.append((each["start"], f"{said}, until {utc(each['stop'])}, rows: {each['rows']}"))
    events += [(each["at"], f"Calibration {each['calibration_id']} activated") for each in timeline["calibrations"]]
    return [f"{utc(at)} {said}" for at, said in sorted(events)] or [words("views.shift.none")]


def _column(samples: Json, quantity: str, member: str) -> "NDArray[np.float64]":
    """Return one column of the samples, NaN where there is no value."""
    series = next(each for each in samples["series"] if each["quantity"] == quantity)
    return np.array([np.nan if each is None else each for each in series[member]], dtype=np.float64)


def _end(values: "NDArray[np.float64]", sign: int) -> str:
    """Return the greatest (1) or least (-1) of the values that are there."""
    held = values[np.isfinite(values)]
    return number(sign * float(np.max(sign * held)) if len(held) else None)
