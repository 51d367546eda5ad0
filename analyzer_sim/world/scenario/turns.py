"""Timetable of the calibration turns: 510 minutes.

Each axis goes through +(0.125, 0.25, 0.375, 0.5) deg and, after a rest at zero, through the same with minus, 15
minutes a level; after each staircase the spacecraft rests 10 minutes at zero. Then the eight corners of 0.3 deg, 10
minutes each, in an order that changes one sign at a time, and a last rest. A level is reached by a slew of 3 minutes
at its start; the published turn is the part after the slew.
"""

from dataclasses import dataclass

LEVELS_DEG = (0.125, 0.25, 0.375, 0.5)
LEVEL_MIN = 15
REST_MIN = 10
CORNER_DEG = 0.3
CORNER_MIN = 10
SLEW_MIN = 3
_GRAY_CORNERS = ((1, 1, 1), (1, 1, -1), (1, -1, -1), (1, -1, 1), (-1, -1, 1), (-1, -1, -1), (-1, 1, -1), (-1, 1, 1))


@dataclass(frozen=True, slots=True)
class Turn:
    """One commanded attitude; minutes from the start of the phase, slew included."""

    start_min: int
    stop_min: int
    #: yaw, roll, pitch
    attitude_deg: tuple[float, float, float]


def timetable() -> tuple[Turn, ...]:
    """Return the turns and the rests between them in order of time."""
    plan: list[tuple[int, tuple[float, float, float]]] = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            for level in LEVELS_DEG:
                angles = [0.0, 0.0, 0.0]
                angles[axis] = sign * level
                plan.append((LEVEL_MIN, (angles[0], angles[1], angles[2])))
            plan.append((REST_MIN, (0.0, 0.0, 0.0)))
    plan += [(CORNER_MIN, (CORNER_DEG * y, CORNER_DEG * r, CORNER_DEG * p)) for y, r, p in _GRAY_CORNERS]
    plan.append((REST_MIN, (0.0, 0.0, 0.0)))
    turns, start_min = [], 0
    for minutes, angles3 in plan:
        turns.append(Turn(start_min, start_min + minutes, angles3))
        start_min += minutes
    return tuple(turns)


TIMETABLE = timetable()
#: duration of the phase, hours
TURNS_H = TIMETABLE[-1].stop_min / 60.0
