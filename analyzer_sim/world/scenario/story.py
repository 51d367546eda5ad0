"""Stories as data: phases, turns, figures of noise and of attitude keeping; no scenario is named here."""

from dataclasses import dataclass, field

from analyzer_sim.epochs import US_PER_H, US_PER_S, epoch_us_from_text
from analyzer_sim.world.scenario.events import Burn, Fault, Manoeuvre, Range
from analyzer_sim.world.sensors import STAR_TRACKER, Sensor

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


DEFAULT_START_US = epoch_us_from_text("2026-11-01T00:00:00Z")

#: sigma and correlation time of one first-order part of a noise, dB and s
Part = tuple[float, float]


@dataclass(frozen=True, slots=True)
class StationNoise:
    """Level of a station in the dry as 284 real links show it; carriers of one station share it; sigmas in dB."""

    #: first-order parts, minutes to days
    parts: tuple[Part, ...] = ((0.038, 300.0), (0.050, 3600.0), (0.080, 28_800.0), (0.060, 259_200.0))
    #: sigma of the logarithm of the scale that a station gives its parts
    parts_spread: float = 0.22
    white_db: float = 0.060
    #: sigma of the logarithm of a station's white noise
    white_spread: float = 0.3
    #: wave of the solar day, peak to peak
    solar_db: Range = (0.06, 0.20)
    #: a station's level with its weather stands on whole multiples of this from its median in dry and wet
    quantum_db: float = 0.15


@dataclass(frozen=True, slots=True)
class NoiseStatistics:
    """Noise beyond what each carrier's plan says; sigmas in dB."""

    #: scale of the carriers' white noise
    white_scale: float = 1.0
    #: range of the AR(1) part of the carriers and its correlation time
    coloured_db: tuple[float, float] = (0.06, 0.11)
    coloured_tau_s: float = 1200.0
    #: receiving chain, common to all carriers
    chain_db: float = 0.08
    chain_tau_s: float = 12 * 3600.0
    chain_daily_db: float = 0.02
    #: amplitude of each user's day of temperature
    thermal_db: float = 0.04
    #: scale of an unstable user's wander and its correlation time
    wander_scale: float = 1.0
    wander_tau_s: float = 3 * 3600.0
    #: further parts of each carrier and of the chain; several of them add up to flicker noise
    flicker: tuple[Part, ...] = ()
    chain_flicker: tuple[Part, ...] = ()
    #: range from which each carrier's scale of its flicker parts is drawn
    flicker_scale: tuple[float, float] = (1.0, 1.0)
    #: levels stand on whole multiples of this; 0 = they do not
    quantum_db: float = 0.0
    #: noise of whole stations; none = every carrier has its own alone
    station: StationNoise | None = None


@dataclass(frozen=True, slots=True)
class ResidualTorque:
    """Torque that neither the loop on board nor the catalogue knows; everything else is fed forward."""

    #: range from which its size about each axis is drawn, N m
    size_n_m: tuple[float, float]
    #: constant; daily: a wave of one day; eclipse: constant, gone in the Earth's shadow
    shape: str = "constant"
    #: impulse about each axis that an unloading of the wheels leaves, N m s, of which nobody is told
    kick_n_m_s: float = 0.0


@dataclass(frozen=True, slots=True)
class KeepingErrors:
    """Errors of attitude keeping; triples in the order yaw, roll, pitch."""

    #: limit cycle under the star tracker, deg
    tracker_deg: tuple[float, float, float] = (0.025, 0.018, 0.018)
    tracker_tau_s: float = 7200.0
    #: error of the angles from which corrections are computed in operation, deg
    knowledge_deg: tuple[float, float, float] = (0.105, 0.038, 0.052)
    knowledge_tau_s: float = 3 * 3600.0
    #: whether corrections are computed from the powers; otherwise from the truth with the error above
    is_steered_by_powers: bool = False
    #: time in which a correction removes the known deviation
    feedback_tau_s: float = 1.5 * 3600.0
    #: drift of the inertial model, deg/h
    drift_deg_h: tuple[float, float, float] = (0.04, 0.025, 0.025)
    drift_tau_s: float = 8 * 3600.0
    #: error of the effect of a correction, one sigma, relative
    scale_error: float = 0.015
    #: whether roll and yaw exchange with the orbital rate
    is_coupled: bool = True
    #: what the catalogue says about it, and what slews are planned with
    is_coupling_announced: bool = True
    #: size of the angles held in the alignment, deg; their signs are drawn
    alignment_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    #: time after the end of a correction at which the ground is told of it, min; none = told before it begins
    corrections_late_min: float | None = None
    #: flown in place of what is left of the Sun's torque; none = the catalogue knows the profile that is fed forward
    residual: ResidualTorque | None = None
    #: moments of inertia that the catalogue states about roll, pitch, yaw, share of the true ones
    stated_inertia: tuple[float, float, float] = (1.0, 1.0, 1.0)
    #: the slowest way of a command over a link, s
    slowest_uplink_s: float = 120.0


@dataclass(frozen=True, slots=True)
class RepeaterSettings:
    """Level controls between a user's transmitter and the receiving site."""

    #: transponders whose automatic level control holds their total power
    alc_transponders: tuple[str, ...] = ()
    #: carriers whose station steers its power by what comes back
    power_controlled: tuple[str, ...] = ()
    #: whether the catalogue says so; otherwise it says `unknown`
    is_power_control_announced: bool = True
    #: time in which a station makes up for a change, and how far it can
    power_control_tau_s: float = 300.0
    power_control_limit_db: float = 6.0


@dataclass(frozen=True, slots=True)
class WheelTelemetry:
    """Wheels whose reported momentum is that of the flown attitude: what they store, and the errors of the report."""

    #: momentum along pitch that every unloading restores, N m s
    bias_n_m_s: float = -8.0
    #: time between two records
    period_min: float = 5.0
    noise_n_m_s: float = 0.01
    #: errors of the axes and of the scale, one sigma
    misalignment_deg: float = 0.05
    scale_error: float = 0.005
    #: torque from outside about each axis: sizes of its constant part and of its daily wave, N m; none = the Sun's, as
    #: it acts in stories without wheels
    torque_n_m: float | None = 1e-5
    #: whether the catalogue states a profile of this torque, and in closed loop the one that is fed forward
    is_profile_stated: bool = True
    #: one sigma of what the stated profile of this torque has wrong: one share of all axes, a smaller one of each
    profile_error: float = 0.05
    axis_profile_error: float = 0.01
    #: wave of half a day, of which nobody knows, as a share of the daily one
    half_day_share: float = 0.01
    #: first-order torque of which nobody knows, N m, and its correlation time
    unknown_n_m: float = 2e-7
    unknown_tau_s: float = 3600.0
    #: greatest change along roll and yaw by an unloading, N m s, and whether telemetry marks it
    unloading_n_m_s: float = 2.0
    is_unloading_marked: bool = True


@dataclass(frozen=True, slots=True)
class RateTelemetry:
    """Rate sensor beside the loop on board, told with every row: its true errors, and what the catalogue says of it."""

    #: first-order bias about each axis, one sigma, deg/h, and its correlation time
    bias_deg_h: float = 0.01
    bias_tau_h: float = 8.0
    #: angle random walk, deg/sqrt(h)
    noise_deg_sqrt_h: float = 0.003
    #: the true bias is so many times what the catalogue states
    bias_factor: float = 1.0


@dataclass(frozen=True)
class PolarimeterFigures:
    """Polarimeter at the receiving site: turn of its feed and what its angle has wrong."""

    feed_offset_deg: float = 10.0
    #: white noise of a report
    white_deg: float = 0.07
    #: leakage of 35 dB, amplitude of its daily wave, sigma of its wander of 4 h
    leakage_deg: float = 1.0
    daily_deg: float = 0.035
    wander_deg: float = 0.04
    #: error of the reported electron content, relative
    map_error: float = 0.15
    #: the true content is so many times the reported one from this hour of operation on
    storm_factor: float = 1.0
    storm_from_h: float = 0.0
    #: turn of the feed at this hour of operation
    feed_turn_deg: float = 0.0
    feed_turn_from_h: float = 0.0
    #: drift of the leakage in operation
    leak_drift_deg_h: float = 0.0


@dataclass(frozen=True, slots=True)
class Phase:
    """One stretch of the story, [start, stop)."""

    name: str
    start_us: int
    stop_us: int


@dataclass(frozen=True, slots=True)
class Scenario:
    """One story."""

    name: str
    summary: str
    start_us: int = DEFAULT_START_US
    row_period_s: float = 60.0
    quiet_h: float = 72.0
    alignment_h: float = 1.0
    operation_h: float = 48.0
    plan: str = "ku16"
    noise: NoiseStatistics = field(default_factory=NoiseStatistics)
    keeping: KeepingErrors = field(default_factory=KeepingErrors)
    manoeuvres: tuple[Manoeuvre, ...] = ()
    faults: tuple[Fault, ...] = ()
    repeater: RepeaterSettings = field(default_factory=RepeaterSettings)
    burns: tuple[Burn, ...] = ()
    #: time between turns and alignment in which nothing is measured
    pause_h: float = 0.0
    #: what tells attitude until the operation phase
    sensors: tuple[Sensor, ...] = (STAR_TRACKER,)
    #: wheels whose momentum follows from attitude and torques; none = hourly figures that act on nothing
    wheels: WheelTelemetry | None = None
    #: rate sensor beside the loop; none = telemetry has no rates
    rates: RateTelemetry | None = None
    #: polarimeter at the receiving site; none = nobody measures polarisation
    polarimeter: PolarimeterFigures | None = None

    @property
    def is_torque_stated(self) -> bool:
        """Return whether the catalogue states the torque from outside."""
        return self.keeping.residual is None and (self.wheels is None or self.wheels.is_profile_stated)

    @property
    def row_period_us(self) -> int:
        """Time between rows, microseconds."""
        return round(self.row_period_s * US_PER_S)

    @property
    def phases(self) -> tuple[Phase, ...]:
        """The phases in order; each begins where the one before it ends, and none is empty."""
        durations_h = {
            "quiet": self.quiet_h,
            "turns": TURNS_H,
            "pause": self.pause_h,
            "alignment": self.alignment_h,
            "operation": self.operation_h,
        }
        phases, start_us = [], self.start_us
        for name, duration_h in durations_h.items():
            stop_us = start_us + round(duration_h * US_PER_H)
            if name != "pause" or stop_us > start_us:
                phases.append(Phase(name, start_us, stop_us))
            start_us = stop_us
        return tuple(phases)

    def phase(self, name: str) -> Phase:
        """Return the phase of this name.

        Raises
        ------
        KeyError
            The story has no such phase.
        """
        for phase in self.phases:
            if phase.name == name:
                return phase
        raise KeyError(f"scenario {self.name} has no phase {name!r}")

    @property
    def operation_start_us(self) -> int:
        """Epoch from which the sensors are off."""
        return self.phases[-1].start_us

    @property
    def stop_us(self) -> int:
        """First epoch after the story."""
        return self.phases[-1].stop_us
