"""Motion that is known beside powers: corrections, released torques, disturbance torque, motion sensors."""

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from operator import attrgetter

import numpy as np

from service.core.estimation.filtering.filter_model import (
    FedForward,
    FilterSettings,
    KnownMotion,
    LearnedMomentum,
    MomentumModel,
    RateSensorModel,
    no_motion,
)
from service.core.estimation.filtering.plant import DAY_US, TORQUES, scale_covariance, wave_period_us
from service.core.estimation.paper.loop_observer import MOTION, Commanded
from service.pipeline.config import RobustConfig
from service.records.calibration import Calibration, GatheredTorque
from service.records.catalogue import AxisTorques, FedForwardTorque, Spacecraft
from service.records.epoch import US_PER_S
from service.records.inputs import Correction
from service.records.levels.attitude import (
    AppliedCommand,
    Axes,
    Disturbance,
    FloatArray,
    Pulse,
    ReleasedCommand,
    ReportedCommand,
)

_US_PER_H = 3600 * US_PER_S
_NEVER_US = 1 << 62
#: exchange of roll and yaw at the orbital rate, 1/h
_ORBITAL_RATE_PER_H = 0.2625162
#: angles that an exchange of roll and yaw turns into drift where nobody knows of it, deg
_USUAL_ROLL_DEG = 0.05
_USUAL_YAW_DEG = 0.2
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


_start_us = attrgetter("start_us")


@dataclass(frozen=True)
class CommandedMotion:
    """Commanded changes from an alignment on, and the part that is still to be applied late."""

    #: changes before this epoch are part of the alignment
    since_us: int
    #: in order of their beginnings, so that a row looks at none of those ahead
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
    commanded: CommandedMotion, further: tuple[_Motion, ...], newest_us: int, *, are_kept: bool = True
) -> CommandedMotion:
    """Return the changes with some more; only their past counts where they are not kept."""
    late_deg, late_rate = np.array(commanded.late_deg), np.array(commanded.late_rate_deg_h)
    for motion in further:
        change_deg, rate_deg_h, lag_deg = _between(motion, commanded.since_us, newest_us)
        late_deg = late_deg + change_deg + lag_deg
        late_rate = late_rate + rate_deg_h
    motions = commanded.motions
    for motion in further if are_kept else ():
        place = bisect_right(motions, motion.start_us, key=_start_us)
        motions = (*motions[:place], motion, *motions[place:])
    kept = _ongoing(motions, newest_us)
    return replace(commanded, motions=kept, late_deg=_triple(late_deg), late_rate_deg_h=_triple(late_rate))


def _ongoing(motions: tuple[_Motion, ...], newest_us: int) -> tuple[_Motion, ...]:
    """Return the motions that go on after an epoch."""
    count = bisect_right(motions, newest_us, key=_start_us)
    kept = tuple(motion for motion in motions[:count] if motion.stop_us > newest_us)
    return motions if len(kept) == count else kept + motions[count:]


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
            break
        change_deg, rate_deg_h, lag_deg = _between(motion, max(from_us, commanded.since_us), to_us)
        correction = correction + change_deg + lag_deg - half_h * rate_deg_h
        rate = rate + rate_deg_h
    return KnownMotion(correction, late, rate), without_past(commanded, to_us)


def without_past(commanded: CommandedMotion, newest_us: int) -> CommandedMotion:
    """Return the changes after rows up to an epoch have consumed theirs and all late ones."""
    return CommandedMotion(commanded.since_us, _ongoing(commanded.motions, newest_us))


def commanded_arrays(commanded: CommandedMotion, until_us: int) -> Commanded:
    """Return the changes that begin before an epoch as compiled functions take them."""
    present = commanded.motions[: bisect_left(commanded.motions, until_us, key=_start_us)]
    motions = np.zeros(len(present), MOTION)
    for k, each in enumerate(present):
        motions[k] = each.start_us, each.stop_us, each.change_deg, each.rate_change_deg_h
    return Commanded(motions, np.array((commanded.late_deg, commanded.late_rate_deg_h)), commanded.since_us)


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


#: torque from outside where no profile is stated, N m: light of the Sun on the arrays of a large comsat
_UNKNOWN_GATHERED_N_M = 2e-5
#: share by which a torque may have changed since it was learned, of all axes together and of each one: it costs
#: yaw by hourly records 0.005 deg of sigma, and a torque that changed by 0.3 misleads by two sigmas in place of seven
_CHANGED_SHARES = (0.1, 0.01)
#: and share by which it changes with its age, a day: twice what the Sun's seasons make
_CHANGED_SHARE_DAY = 0.01
#: size of the wander of a torque that was learned, as a share of it: 1 % in two days, what the Sun's seasons make
_WANDER_SHARE = 0.2


def residual_torque_n_m(spacecraft: Spacecraft | None, unknown_n_m: float, least_n_m: float) -> float:
    """Return the size of the torque of unknown shape that is not fed forward, N m.

    Where the catalogue does not state it, `unknown_n_m` is the prior. What it states is a belief: a torque that was
    called none is one of `least_n_m`, so that it can be learned.
    """
    if spacecraft is None:
        return 0.0
    stated_n_m = spacecraft.onboard.residual_torque_n_m
    return unknown_n_m if stated_n_m is None else max(stated_n_m, least_n_m)


def axis_accelerations_deg_h2(spacecraft: Spacecraft | None, torque_n_m: float) -> tuple[float, float, float]:
    """Return the accelerations of yaw, roll and pitch by a torque about each; none of a spacecraft not known."""
    if spacecraft is None:
        return (0.0, 0.0, 0.0)
    yaw, roll, pitch = (torque_n_m / DEG_H2_N_M / inertia for inertia in angle_inertia_kg_m2(spacecraft))
    return yaw, roll, pitch


def motion_settings(spacecraft: Spacecraft | None, config: RobustConfig) -> FilterSettings:
    """Return how the spacecraft moves, sensors beside the powers left out.

    An exchange of roll and yaw that nobody knows of is drift of either by what the usual angle of the other makes.
    """
    is_coupled = True if spacecraft is None else spacecraft.onboard.roll_yaw_coupling
    unknown_per_h = _ORBITAL_RATE_PER_H if is_coupled is None else 0.0
    fed = fed_forward(spacecraft)
    residual_n_m = residual_torque_n_m(spacecraft, config.unknown_torque_n_m, config.least_stated_torque_n_m)
    return FilterSettings(
        coupling_per_h=_ORBITAL_RATE_PER_H if is_coupled else 0.0,
        drift_deg_h=(
            math.hypot(config.yaw_drift_deg_h, unknown_per_h * _USUAL_ROLL_DEG),
            math.hypot(config.roll_drift_deg_h, unknown_per_h * _USUAL_YAW_DEG),
            config.pitch_drift_deg_h,
        ),
        drift_tau_h=config.drift_time_h,
        correction_scale=config.correction_scale_error,
        torque_scale=config.torque_scale_error,
        torque_deg_h2=axis_accelerations_deg_h2(spacecraft, residual_n_m),
        # a profile that is fed forward has an error of its own, which is known
        unknown_torque_deg_h2=axis_accelerations_deg_h2(spacecraft, config.unknown_torque_n_m if fed is None else 0.0),
        fed_forward=fed,
    )


def disturbance_of(
    wave_deg_h2: FloatArray, settings: FilterSettings, inertia_kg_m2: tuple[float, float, float], epoch_us: int
) -> Disturbance:
    """Return a torque (4, 3), its constant, its cosine and sine since an epoch, and its sigma, as a record."""
    parts_n_m = wave_deg_h2 * (np.array(inertia_kg_m2) * DEG_H2_N_M)
    return Disturbance(epoch_us, wave_period_us(settings) / US_PER_S, *map(Axes._make, parts_n_m.tolist()))


def is_torque_unknown(spacecraft: Spacecraft | None) -> bool:
    """Return whether the catalogue does not state the size of the torque that is not fed forward."""
    return spacecraft is not None and spacecraft.onboard.residual_torque_n_m is None


def fed_forward(spacecraft: Spacecraft | None) -> FedForward | None:
    """Return the profile that the loop on board takes away, its phase counted from the beginning of 1970."""
    reported = None if spacecraft is None else spacecraft.onboard.fed_forward_torque
    return None if spacecraft is None or reported is None else _profile(reported, spacecraft)


def momentum_model(
    spacecraft: Spacecraft | None, calibration: Calibration | None = None, epoch_us: int = 0
) -> MomentumModel | None:
    """Return how the momentum of the wheels is read; None where the catalogue does not use it, or turns contradict.

    What the quiet days of the calibration told of the torque takes the place of what the catalogue states; it is known
    less well by the time until an epoch. Where the error of a profile that is fed forward also moves the body, the
    catalogue alone says how large it is.
    """
    stated = None if spacecraft is None else spacecraft.onboard.momentum
    if spacecraft is None or stated is None or not stated.used:
        return None
    if calibration is not None and calibration.is_momentum_contradicted:
        return None
    is_profile_known = stated.torque is not None or spacecraft.onboard.fed_forward_torque is not None
    profile = None if stated.torque is None else _profile(stated.torque, spacecraft)
    unknown = None if is_profile_known else _accelerations(AxisTorques(*[_UNKNOWN_GATHERED_N_M] * 3), spacecraft)
    learned, result = None, None if calibration is None else calibration.result
    gathered = None if result is None else result.gathered
    if gathered is not None and spacecraft.onboard.fed_forward_torque is None:
        learned = _learned(gathered, spacecraft, epoch_us)
        profile, unknown = None, _WANDER_SHARE * _size(learned)
    return MomentumModel(
        stated.sigma_n_m_s,
        stated.scale_error,
        stated.misalignment_deg,
        angle_inertia_kg_m2(spacecraft),
        profile,
        None if unknown is None else _triple(unknown),
        learned=learned,
    )


def learned_units(spacecraft: Spacecraft) -> FloatArray:
    """Return the factors (13,) from `LearnedMomentum` to `GatheredTorque`: N m per deg/h^2, then 1 of the errors."""
    torques_n_m = np.tile(DEG_H2_N_M * np.array(angle_inertia_kg_m2(spacecraft)), TORQUES // 3)
    return np.concatenate([torques_n_m, np.ones(4)])


def _size(learned: LearnedMomentum) -> FloatArray:
    """Return the size (3,) of a torque that was learned, constant and wave together."""
    return np.asarray(np.linalg.norm(np.array(learned.mean[:TORQUES]).reshape(3, 3), axis=0))


def _learned(gathered: GatheredTorque, spacecraft: Spacecraft, epoch_us: int) -> LearnedMomentum:
    """Return what quiet days told as accelerations; each part of the torque may have changed with its age."""
    scale = 1.0 / learned_units(spacecraft)
    mean = scale * np.array(gathered.mean)
    covariance = scale[:, None] * np.array(gathered.covariance) * scale
    days = max(0.0, (epoch_us - gathered.stop_us) / US_PER_S / 86_400.0)
    lost = min(1.0, _CHANGED_SHARE_DAY * days) ** 2
    fresh = LearnedMomentum(tuple(mean.tolist()), tuple(map(tuple, covariance.tolist())))
    constant, cosine, sine = map(_triple, mean[:TORQUES].reshape(3, 3))
    changed = scale_covariance(FedForward(constant, cosine, sine, *_CHANGED_SHARES, DAY_US))
    covariance[:TORQUES, :TORQUES] += lost * np.diag(np.tile(_size(fresh) ** 2, 3)) + changed
    return fresh._replace(covariance=tuple(map(tuple, covariance.tolist())))


def rate_sensor_model(spacecraft: Spacecraft | None, *, is_contradicted: bool = False) -> RateSensorModel | None:
    """Return how the rates of the body are read; None where the catalogue has no sensor beside the loop."""
    stated = None if spacecraft is None else spacecraft.onboard.rate_sensor
    if stated is None or stated.in_loop or is_contradicted:
        return None
    bias, tau_h, noise = stated.bias_deg_h, stated.bias_tau_h, stated.noise_deg_sqrt_h
    if bias is None or tau_h is None or noise is None:
        return None
    return RateSensorModel(bias, tau_h, noise)


def is_rate_in_loop(spacecraft: Spacecraft | None) -> bool:
    """Return whether the rates of the body are those of a sensor that the loop on board holds still."""
    stated = None if spacecraft is None else spacecraft.onboard.rate_sensor
    return stated is not None and stated.in_loop


def _profile(reported: FedForwardTorque, spacecraft: Spacecraft) -> FedForward:
    period_us = round(reported.period_s * US_PER_S)
    phase = 2.0 * math.pi * (reported.epoch_us % period_us) / period_us
    constant, cosine, sine = (
        _accelerations(part, spacecraft) for part in (reported.constant_n_m, reported.cosine_n_m, reported.sine_n_m)
    )
    return FedForward(
        _triple(constant),
        _triple(math.cos(phase) * cosine - math.sin(phase) * sine),
        _triple(math.sin(phase) * cosine + math.cos(phase) * sine),
        reported.relative_error,
        reported.axis_relative_error,
        period_us,
    )


def _accelerations(torque_n_m: AxisTorques, spacecraft: Spacecraft) -> FloatArray:
    """Return the accelerations of yaw, roll and pitch by a torque (3,), deg/h^2."""
    torque = np.array([torque_n_m.yaw, torque_n_m.roll, torque_n_m.pitch])
    return np.asarray(torque / DEG_H2_N_M / np.array(angle_inertia_kg_m2(spacecraft)))
