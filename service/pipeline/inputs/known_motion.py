"""Motion commanded by the ground: corrections through other channels and released torques, as input of the filter.

A correction is spread evenly over its interval; a pulse changes the rate for good and acts from its middle on. Motion
within rows that were consumed before it became known is applied to the state at once. From its first pulse on a
command replaces all before it, as it does on board: their remaining pulses are not flown. The law of this file:
the same journal gives the same input, and nothing counts twice.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from service.core.estimation.filtering.model.filter_model import KnownMotion, no_motion
from service.records.catalogue import Spacecraft
from service.records.epoch import US_PER_S
from service.records.inputs import Correction
from service.records.levels.attitude import FloatArray
from service.records.levels.command import AppliedCommand, Pulse, ReleasedCommand, ReportedCommand

_US_PER_H = 3600 * US_PER_S
_NEVER_US = 1 << 62
#: torque that gives 1 kg m^2 an acceleration of 1 deg/h^2
DEG_H2_N_M = math.radians(1.0) / 3600.0**2


@dataclass(frozen=True)
class _Motion:
    """One commanded change; triples in the order yaw, roll, pitch."""

    start_us: int
    stop_us: int
    #: (3,) deg, spread over the interval
    change_deg: FloatArray
    #: (3,) deg/h, gained in the middle of the interval
    rate_change_deg_h: FloatArray
    #: journal number of the row whose command it belongs to: the next command ends it
    number: int | None = None
    #: of the released command that it belongs to: one with a greater counter ends it; neither = nothing ends it
    counter: int | None = None


@dataclass(frozen=True)
class CommandedMotion:
    """Commanded changes from an alignment on, and the part that is still to be applied late."""

    #: changes before this epoch are part of the alignment
    since_us: int
    motions: tuple[_Motion, ...] = ()
    late_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    late_rate_deg_h: tuple[float, float, float] = (0.0, 0.0, 0.0)


def heard(
    commanded: CommandedMotion,
    content: Correction | AppliedCommand | ReportedCommand,
    record: Spacecraft | None,
    newest_us: int,
) -> CommandedMotion:
    """Return the changes with one more, which became known when rows up to ``newest_us`` had been consumed.

    A command that counts as applied, or was carried out, ends those before it.
    """
    match content:
        case Correction():
            return _with(commanded, _of_correction(content), newest_us)
        case ReportedCommand():
            ended = without_replaced(commanded, content.counter, content.executed, newest_us)
            return _with(ended, _of_pulses(content.executed, record, counter=content.counter), newest_us)
        case AppliedCommand():
            command = content.command
            is_before = partial(_is_of_row_before, number=command.number)
            ended = _ended(commanded, is_before, command.epoch_us, newest_us)
            return _with(ended, _of_pulses(command.schedule, record, number=command.number), newest_us)


def motions_of_released(
    commanded: CommandedMotion, released: ReleasedCommand, record: Spacecraft | None, newest_us: int
) -> CommandedMotion:
    """Return the effect of a released command: its own pulses, and the known motion under way without it."""
    nothing = CommandedMotion(commanded.since_us)
    own = _with(nothing, _of_pulses(released.schedule, record, counter=released.counter), newest_us)
    start_us = first_us(released.schedule)
    is_before = partial(_is_of_release_before, counter=released.counter)
    replaced = (_rest(motion, start_us) for motion in commanded.motions if is_before(motion))
    left_out = tuple(replace(rest, counter=released.counter) for rest in replaced if rest is not None)
    return _with(own, left_out, newest_us)


def without_replaced(
    commanded: CommandedMotion, counter: int, schedule: Sequence[Pulse], newest_us: int
) -> CommandedMotion:
    """Return the changes when the pulses of a command take the place of what earlier releases have left."""
    return _ended(commanded, partial(_is_of_release_before, counter=counter), first_us(schedule), newest_us)


def first_us(schedule: Iterable[Pulse]) -> int:
    """Return when the first pulse begins; without pulses in the far future, so that nothing gives way to them."""
    return min((pulse.start_us for pulse in schedule), default=_NEVER_US)


def end_us(content: Correction | AppliedCommand | ReportedCommand) -> int:
    """Return when a commanded motion ends."""
    match content:
        case Correction():
            return content.stop_us
        case ReportedCommand():
            return max(map(_pulse_stop_us, content.executed), default=content.reported_us)
        case AppliedCommand():
            return max(content.command.valid_until_us, *map(_pulse_stop_us, content.command.schedule), 0)


def _is_of_row_before(motion: _Motion, *, number: int) -> bool:
    return motion.number is not None and motion.number < number


def _is_of_release_before(motion: _Motion, *, counter: int) -> bool:
    return motion.counter is not None and motion.counter < counter


def _ended(
    commanded: CommandedMotion, is_before: Callable[[_Motion], bool], stop_us: int, newest_us: int
) -> CommandedMotion:
    """Return the changes when pulses of earlier commands end at an instant; rows may have consumed more of them."""
    kept, undone = [], []
    for motion in commanded.motions:
        rest = _rest(motion, stop_us) if is_before(motion) else None
        if rest is None:
            kept.append(motion)
            continue
        if rest.start_us < newest_us:
            undone.append(rest)
        if rest.start_us > motion.start_us:
            left = motion.rate_change_deg_h + rest.rate_change_deg_h
            kept.append(replace(motion, stop_us=rest.start_us, rate_change_deg_h=left))
    return _with(replace(commanded, motions=tuple(kept)), tuple(undone), newest_us, are_kept=False)


def _rest(motion: _Motion, from_us: int) -> _Motion | None:
    """Return the reverse of the part of a motion after an instant; None where there is none."""
    if motion.stop_us <= from_us:
        return None
    cut_us = max(motion.start_us, from_us)
    share = (motion.stop_us - cut_us) / (motion.stop_us - motion.start_us)
    return replace(motion, start_us=cut_us, rate_change_deg_h=-share * motion.rate_change_deg_h)


def _with(
    commanded: CommandedMotion, reported: tuple[_Motion, ...], newest_us: int, *, are_kept: bool = True
) -> CommandedMotion:
    """Return the changes with some more; only their past counts where they are not kept."""
    late_deg, late_rate = np.array(commanded.late_deg), np.array(commanded.late_rate_deg_h)
    for motion in reported:
        change_deg, rate_deg_h, lag_deg = _between(motion, commanded.since_us, newest_us)
        late_deg = late_deg + change_deg + lag_deg
        late_rate = late_rate + rate_deg_h
    motions = (*commanded.motions, *reported) if are_kept else commanded.motions
    kept = tuple(motion for motion in motions if motion.stop_us > newest_us)
    return replace(commanded, motions=kept, late_deg=_triple(late_deg), late_rate_deg_h=_triple(late_rate))


def consume(commanded: CommandedMotion, from_us: int, to_us: int) -> tuple[KnownMotion, CommandedMotion]:
    """Return the motion commanded between two epochs with all late ones, and the remaining changes."""
    if not (commanded.motions or any(commanded.late_deg) or any(commanded.late_rate_deg_h)):
        # most rows of a spacecraft that nobody commands
        return no_motion(), commanded
    correction, rate = np.zeros(3), np.array(commanded.late_rate_deg_h)
    late = np.array(commanded.late_deg)
    # the filter lets a gained rate act for half of the step: a late one acted for all of it, a pulse from its middle on
    half_h = 0.5 * (to_us - from_us) / _US_PER_H
    late = late + half_h * rate
    for motion in commanded.motions:
        if motion.start_us >= to_us:
            # most commands lie ahead
            continue
        change_deg, rate_deg_h, lag_deg = _between(motion, max(from_us, commanded.since_us), to_us)
        correction = correction + change_deg + lag_deg - half_h * rate_deg_h
        rate = rate + rate_deg_h
    left = tuple(motion for motion in commanded.motions if motion.stop_us > to_us)
    return KnownMotion(correction, late, rate), CommandedMotion(commanded.since_us, left)


def _between(motion: _Motion, from_us: int, to_us: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return change, rate and what the rate has turned until the end, of the part of a motion between two epochs."""
    start_us, stop_us = max(motion.start_us, from_us), min(motion.stop_us, to_us)
    nothing = np.zeros(3)
    if stop_us <= start_us:
        return nothing, nothing, nothing
    share = (stop_us - start_us) / (motion.stop_us - motion.start_us)
    rate_deg_h = share * motion.rate_change_deg_h
    acted_h = (to_us - 0.5 * (start_us + stop_us)) / _US_PER_H
    return share * motion.change_deg, rate_deg_h, rate_deg_h * acted_h


def _of_correction(correction: Correction) -> tuple[_Motion, ...]:
    """Return a correction; an angle that is not told does not move, an instant lasts a microsecond."""
    change_deg = np.nan_to_num(np.array(correction.change_deg, dtype=np.float64))
    return (_Motion(correction.start_us, max(correction.stop_us, correction.start_us + 1), change_deg, np.zeros(3)),)


def _of_pulses(
    pulses: Iterable[Pulse], record: Spacecraft | None, *, number: int | None = None, counter: int | None = None
) -> tuple[_Motion, ...]:
    """Return the pulses of a command; without a spacecraft nothing is known of their effect."""
    if record is None:
        return ()
    inertia = np.array(angle_inertia_kg_m2(record))
    motions = []
    for pulse in pulses:
        gained_deg_h = np.rad2deg(np.array(pulse.torque_n_m) * pulse.duration_s / inertia) * 3600.0
        stop_us = max(pulse.start_us + 1, _pulse_stop_us(pulse))
        motions.append(_Motion(pulse.start_us, stop_us, np.zeros(3), gained_deg_h, number, counter))
    return tuple(motions)


def _pulse_stop_us(pulse: Pulse) -> int:
    return pulse.start_us + round(pulse.duration_s * US_PER_S)


def angle_inertia_kg_m2(record: Spacecraft) -> tuple[float, float, float]:
    """Return the inertia about yaw, roll and pitch."""
    x, y, z = (record.inertia_kg_m2[k][k] for k in range(3))
    return z, x, y


def _triple(values: FloatArray) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
