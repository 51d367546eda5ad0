"""Lines of the plant's input: a torque schedule, perhaps with its counter, within the limits of what can be flown."""

import json
import math
from typing import NamedTuple

from analyzer_sim.epochs import US_PER_S, epoch_us_from_text, rfc3339
from analyzer_sim.world.ground.ground_bodies import TORQUE_LIMIT_N_M
from analyzer_sim.world.spacecraft.angles_loop import Angles
from analyzer_sim.world.spacecraft.rigid_body import TorqueElement

#: longest line, elements of one schedule, duration of one element, s, and largest counter
MAX_LINE_CHARACTERS = 1_000_000
MAX_ELEMENTS = 10_000
MIN_DURATION_S, MAX_DURATION_S = 1e-6, 86_400.0
MAX_COUNTER = 2**32 - 1
MAX_ANGLE_DEG = 180.0
_ANGLE_FIELDS = {"counter", "attitude_epoch", "valid_until", "attitude_deg"}
_FIELDS = {"start", "duration_s", "roll_n_m", "pitch_n_m", "yaw_n_m"}


class ScheduleError(ValueError):
    """A line holds no valid schedule; the text gives the reason."""


class Schedule(NamedTuple):
    """Torque schedule of one line of the uplink protocol."""

    elements: tuple[TorqueElement, ...]
    #: None = the plant counts
    counter: int | None = None
    #: for the loop on board
    angles: Angles | None = None


def parse_schedule(text: str, not_before_us: int) -> Schedule:
    """Return the schedule of a line.

    Raises
    ------
    ScheduleError
        Too long, not JSON, not a schedule, an element that begins before `not_before_us` or exceeds a limit.
    """
    if len(text) > MAX_LINE_CHARACTERS:
        raise ScheduleError(f"a line holds at most {MAX_LINE_CHARACTERS} characters")
    try:
        # an integer of a thousand digits is infinite, not an error
        message = json.loads(text, parse_int=float)
    except (ValueError, RecursionError):
        raise ScheduleError("a line is one JSON object") from None
    if not isinstance(message, dict) or not {"schedule"} <= set(message) <= {"schedule", "counter", "attitude"}:
        raise ScheduleError('a line is {"schedule": [..]}, perhaps with a counter or an attitude, and nothing else')
    reported = message["schedule"]
    if not isinstance(reported, list):
        raise ScheduleError("the schedule is a list of elements")
    if len(reported) > MAX_ELEMENTS:
        raise ScheduleError(f"a schedule holds at most {MAX_ELEMENTS} elements")
    elements = tuple(_element(k, item, not_before_us) for k, item in enumerate(reported))
    counter = _counter(message["counter"]) if "counter" in message else None
    return Schedule(elements, counter, _angles(message["attitude"]) if "attitude" in message else None)


def _angles(item: object) -> Angles:
    """Return the angles of a line, fields as in `attitude/uplink`."""
    if not isinstance(item, dict) or not set(item) >= _ANGLE_FIELDS or not isinstance(item["attitude_deg"], dict):
        raise ScheduleError(f"an attitude has {', '.join(sorted(_ANGLE_FIELDS))}")
    reported = [item["attitude_deg"].get(axis) for axis in ("yaw", "roll", "pitch")]
    yaw, roll, pitch = (angle if isinstance(angle, float) else math.nan for angle in reported)
    # NaN is not within either
    if not all(abs(angle) <= MAX_ANGLE_DEG for angle in (yaw, roll, pitch)):
        raise ScheduleError(f"attitude_deg holds yaw, roll and pitch within {MAX_ANGLE_DEG:g} deg")
    epoch_us, until_us = (_epoch_us("attitude", name, item[name]) for name in ("attitude_epoch", "valid_until"))
    return Angles(_counter(item["counter"]), epoch_us, until_us, (yaw, roll, pitch))


def _counter(value: object) -> int:
    if not isinstance(value, float) or not 0.0 <= value <= MAX_COUNTER or not value.is_integer():
        raise ScheduleError(f"the counter is a whole number of 0..{MAX_COUNTER}")
    return int(value)


def _element(number: int, item: object, not_before_us: int) -> TorqueElement:
    if not isinstance(item, dict) or set(item) != _FIELDS:
        raise ScheduleError(f"element {number}: the fields are {', '.join(sorted(_FIELDS))}")
    duration_s = _number(number, item, "duration_s")
    if not MIN_DURATION_S <= duration_s <= MAX_DURATION_S:
        raise ScheduleError(f"element {number}: duration_s lies outside {MIN_DURATION_S:g}..{MAX_DURATION_S:g}")
    start_us = _epoch_us(f"element {number}", "start", item["start"])
    if start_us < not_before_us:
        raise ScheduleError(f"element {number}: it begins before the row of {rfc3339(not_before_us)}")
    yaw, roll, pitch = (_number(number, item, f"{axis}_n_m") for axis in ("yaw", "roll", "pitch"))
    if max(abs(yaw), abs(roll), abs(pitch)) > TORQUE_LIMIT_N_M:
        raise ScheduleError(f"element {number}: a torque exceeds {TORQUE_LIMIT_N_M:g} N m")
    return TorqueElement(start_us, start_us + round(duration_s * US_PER_S), (yaw, roll, pitch))


def _number(number: int, item: dict[str, object], name: str) -> float:
    value = item[name]
    if not isinstance(value, float) or not math.isfinite(value):
        raise ScheduleError(f"element {number}: {name} is not a finite number")
    return value


def _epoch_us(what: str, name: str, text: object) -> int:
    try:
        return epoch_us_from_text(str(text))
    except (ValueError, OverflowError):
        raise ScheduleError(f"{what}: {name} is no RFC 3339 epoch with a zone") from None
