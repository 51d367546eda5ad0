"""Events of a scenario, as data: what happens, to whom, when; and the planned attitude of the operation phase."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from analyzer_sim.streams import FloatArray, stream

#: low and high end of a uniform draw; equal ends fix the value
Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Hold:
    """The spacecraft slews to an attitude, stays and slews back to zero."""

    start_h: float
    #: from the start of the slew out to the start of the slew back
    hold_h: float
    slew_min: float = 20.0
    yaw_deg: float = 0.0
    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    #: whether the ground was told by corrections
    is_announced: bool = True
    #: whether of an unannounced hold at least the corrections against the exchange of roll and yaw were told
    is_balance_announced: bool = False


@dataclass(frozen=True, slots=True)
class Tour:
    """Holds one after another through all octants in drawn order, to the end of the operation phase."""

    name: str
    start_h: float = 1.5
    yaw_deg: Range = (0.2, 0.3)
    roll_deg: Range = (0.2, 0.33)
    pitch_deg: Range = (0.2, 0.33)
    hold_h: Range = (2.5, 3.5)
    slew_min: Range = (60.0, 90.0)


@dataclass(frozen=True, slots=True)
class FalseReport:
    """A slew that the ground announces in full and the spacecraft follows by a share; later it slews back."""

    name: str
    start_h: float
    #: what the spacecraft does of it: 0 = nothing, -1 = the opposite
    executed_share: float
    #: size of the announced change; its signs are drawn
    yaw_deg: float = 0.15
    roll_deg: float = 0.15
    pitch_deg: float = 0.15
    duration_h: float = 2.0
    #: from the start until the spacecraft slews back
    hold_h: float = 8.0


@dataclass(frozen=True, slots=True)
class Burn:
    """Station keeping: the orbit changes at once, the ground has its new ephemeris some time later."""

    name: str
    start_h: Range
    #: size of the change of the inclination vector, deg; its direction follows from the place of the burn
    inclination_deg: Range = (0.02, 0.035)
    #: change of the drift in longitude without its sign, deg/day
    drift_deg_day: Range = (0.0, 0.0)
    duration_min: float = 40.0
    ephemeris_after_h: float = 6.0
    #: what the declared operation says, yaw, roll, pitch, deg; none = nothing
    attitude_uncertainty_deg: tuple[float, float, float] | None = None


@dataclass(frozen=True, slots=True)
class UplinkRain:
    """Rain over stations: the carriers fade one by one, each on its own."""

    name: str
    #: number of showers
    count: int
    #: carriers that can be hit; empty = all
    carriers: tuple[str, ...] = ()
    start_h: Range = (0.5, 47.0)
    depth_db: Range = (0.8, 5.0)
    slope_db_min: Range = (0.05, 0.6)
    #: time at full depth
    duration_min: Range = (10.0, 90.0)


@dataclass(frozen=True, slots=True)
class DownlinkRain:
    """Rain over the receiving site: all carriers fade together."""

    name: str
    start_h: Range = (6.0, 7.0)
    depth_db: Range = (3.0, 3.0)
    slope_db_min: Range = (0.1, 0.1)
    duration_min: Range = (60.0, 60.0)


@dataclass(frozen=True, slots=True)
class SwitchOff:
    """A carrier leaves the air and comes back, perhaps at another level."""

    name: str
    #: empty = drawn
    carriers: tuple[str, ...] = ()
    start_h: Range = (4.0, 40.0)
    duration_h: Range = (2.0, 8.0)
    level_after_db: Range = (0.0, 0.0)
    #: whether an operation is declared
    is_announced: bool = False


@dataclass(frozen=True, slots=True)
class Step:
    """A user's level steps and stays."""

    name: str
    count: int = 1
    carriers: tuple[str, ...] = ()
    start_h: Range = (1.0, 46.0)
    #: size without its sign, which is drawn
    size_db: Range = (0.8, 3.0)


@dataclass(frozen=True, slots=True)
class GroupStep:
    """The gain of a transponder steps: all its carriers together."""

    name: str
    #: empty = drawn
    transponder: str = ""
    start_h: Range = (1.0, 46.0)
    size_db: Range = (0.8, 2.0)
    #: 0 = for good
    duration_h: float = 0.0
    #: whether an operation is declared
    is_announced: bool = False


@dataclass(frozen=True, slots=True)
class ChainStep:
    """The receiving chain steps by a signed amount, all carriers together (recalibration, switching)."""

    name: str
    start_h: Range = (12.0, 12.0)
    size_db: Range = (0.5, 0.5)
    #: whether an operation is declared
    is_announced: bool = False


@dataclass(frozen=True, slots=True)
class Interference:
    """A narrow signal inside a carrier's band."""

    name: str
    count: int = 1
    carriers: tuple[str, ...] = ()
    start_h: Range = (1.0, 44.0)
    duration_min: Range = (20.0, 180.0)
    #: power relative to the carrier's
    level_db: Range = (-7.0, 0.0)


@dataclass(frozen=True, slots=True)
class Gap:
    """Nothing is measured."""

    name: str
    count: int = 1
    start_h: Range = (1.0, 44.0)
    duration_min: Range = (10.0, 180.0)


@dataclass(frozen=True, slots=True)
class Storm:
    """Rain cells; each takes several stations one after another, and their wet antennas dry slowly."""

    name: str
    #: number of cells
    count: int
    start_h: Range = (0.5, 44.0)
    #: fewest and most stations of a cell, neighbours in longitude
    stations: tuple[int, int] = (3, 6)
    #: from one station to the next
    between_min: Range = (10.0, 40.0)
    depth_db: Range = (1.5, 6.0)
    slope_db_min: Range = (0.1, 0.6)
    duration_min: Range = (10.0, 40.0)
    #: loss of the wet antenna, gone to a twentieth an hour after the rain
    wet_db: Range = (0.8, 2.0)
    dry_tau_min: float = 20.0


@dataclass(frozen=True, slots=True)
class Weather:
    """Weather over the users' stations as real links show it: systems of hours with showers and steady rain."""

    name: str
    #: mean time from the start of one system to the start of the next
    interval_days: float = 1.7
    #: share of the stations that one system takes; 0 = each station has systems of its own
    shared: float = 0.0
    #: sigma of the time by which a shared system comes to a station earlier or later
    shift_min: float = 45.0


@dataclass(frozen=True, slots=True)
class WeatherSystem:
    """One system of the kind that `Weather` draws, at a given time over a share of the stations."""

    name: str
    start_h: Range
    duration_h: Range
    #: share of the stations
    share: float


@dataclass(frozen=True, slots=True)
class Showers:
    """One shower of the kind that `Weather` draws over each station of a share."""

    name: str
    start_h: Range
    #: share of the stations
    share: float


@dataclass(frozen=True, slots=True)
class Relevel:
    """Change of all users' levels, each by a Gaussian step of its own."""

    name: str
    start_h: float
    sigma_db: float = 0.5


@dataclass(frozen=True, slots=True)
class PlanChange:
    """Carriers leave for good and others come; the ground publishes a new plan."""

    name: str
    start_h: float
    gone: tuple[str, ...]
    new: tuple[str, ...]
    #: whether the new plan names its carriers the other way round
    is_order_reversed: bool = False


@dataclass(frozen=True, slots=True)
class SourceSwitch:
    """Measuring goes over to the second analyzer, behind a receiving chain of its own, and back; the ground does it."""

    name: str
    start_h: Range
    duration_h: Range
    #: gain of the second chain against the first
    gain_db: Range = (-0.4, -0.4)


@dataclass(frozen=True, slots=True)
class Eclipse:
    """The spacecraft cools in the Earth's shadow: gains of the transponders fall, the receiving reflector bends."""

    name: str
    start_h: Range
    duration_min: Range = (55.0, 72.0)
    #: fall of a transponder's gain, drawn for each
    gain_db: Range = (0.2, 0.5)
    #: shift of the uplink pattern, in a drawn direction
    shift_deg: Range = (0.02, 0.05)
    tau_min: float = 20.0


@dataclass(frozen=True, slots=True)
class PatternWave:
    """The Sun bends the receiving reflector: from the start of operation on the uplink patterns move once a day."""

    name: str
    #: amplitude of the shift to East and to North; phases are drawn
    size_deg: tuple[float, float] = (0.03, 0.02)


@dataclass(frozen=True, slots=True)
class SunOutage:
    """The Sun stands behind the satellite: the noise at the receiving site rises."""

    name: str
    start_h: Range
    duration_min: Range = (8.0, 15.0)
    rise_db: Range = (3.0, 10.0)


Fault = (
    UplinkRain
    | DownlinkRain
    | SwitchOff
    | Step
    | GroupStep
    | ChainStep
    | Interference
    | Gap
    | Storm
    | Weather
    | WeatherSystem
    | Showers
    | Relevel
    | PlanChange
    | Eclipse
    | PatternWave
    | SunOutage
    | SourceSwitch
)
Manoeuvre = Hold | Tour | FalseReport


#: a slew is commanded in pieces no longer than this, a hold in pieces no longer than that, s
SLEW_CHUNK_S = 300.0
HOLD_CHUNK_S = 1800.0


def holds_of(manoeuvres: Sequence[Manoeuvre], seed: int, operation_h: float) -> tuple[Hold, ...]:
    """Return all holds of the phase, with what a tour leaves open drawn from its stream."""
    holds: list[Hold] = []
    for manoeuvre in manoeuvres:
        if isinstance(manoeuvre, Hold):
            holds.append(manoeuvre)
        elif isinstance(manoeuvre, FalseReport):
            holds.append(_reported_hold(manoeuvre, seed, manoeuvre.executed_share))
        else:
            holds.extend(_tour_holds(manoeuvre, seed, operation_h))
    return tuple(holds)


def unexecuted_deg(manoeuvres: Sequence[Manoeuvre], seed: int, hours: FloatArray) -> FloatArray:
    """Return how far (T, 3) the announced attitude has run ahead of the executed one by false reports, deg."""
    lead = np.zeros((len(hours), 3))
    for report in manoeuvres:
        if isinstance(report, FalseReport):
            missing = _reported_hold(report, seed, 1.0 - report.executed_share)
            share = _ramp(hours, report.start_h, report.duration_h)
            lead += share[:, None] * np.array([missing.yaw_deg, missing.roll_deg, missing.pitch_deg])
    return lead


def _reported_hold(report: FalseReport, seed: int, share: float) -> Hold:
    """Return this share of the announced hold; its signs are drawn once."""
    signs = stream(seed, "false report", report.name).choice([-1.0, 1.0], size=3)
    yaw, roll, pitch = (share * signs * [report.yaw_deg, report.roll_deg, report.pitch_deg]).tolist()
    return Hold(report.start_h, report.hold_h, 60.0 * report.duration_h, yaw, roll, pitch)


def _tour_holds(tour: Tour, seed: int, operation_h: float) -> list[Hold]:
    """Draw octants in shuffled rounds of eight; each hold ends where the next slew begins."""
    rng = stream(seed, "tour", tour.name)
    holds: list[Hold] = []
    start_h = tour.start_h
    order: list[int] = []
    while True:
        order = order or rng.permutation(8).tolist()
        octant = order.pop()
        signs = [1.0 if octant & bit else -1.0 for bit in (4, 2, 1)]
        yaw, roll, pitch = (
            sign * _draw(rng, limits)
            for sign, limits in zip(signs, (tour.yaw_deg, tour.roll_deg, tour.pitch_deg), strict=True)
        )
        hold_h, slew_min = _draw(rng, tour.hold_h), _draw(rng, tour.slew_min)
        if start_h + hold_h + slew_min / 60.0 > operation_h:
            return holds
        holds.append(Hold(start_h, hold_h, slew_min, yaw, roll, pitch))
        start_h += hold_h + slew_min / 60.0


def _draw(rng: np.random.Generator, limits: Range) -> float:
    return float(rng.uniform(*limits))


def planned_deg(holds: Sequence[Hold], hours: FloatArray) -> FloatArray:
    """Return the planned attitude (T, 3) at hours from the start of operation, deg."""
    plan = np.zeros((len(hours), 3))
    for hold in holds:
        slew_h = hold.slew_min / 60.0
        share = _ramp(hours, hold.start_h, slew_h) - _ramp(hours, hold.start_h + hold.hold_h, slew_h)
        plan += share[:, None] * np.array([hold.yaw_deg, hold.roll_deg, hold.pitch_deg])
    return plan


def _ramp(hours: FloatArray, start_h: float, slew_h: float) -> FloatArray:
    """Return a cosine rise from 0 to 1."""
    share = np.clip((hours - start_h) / slew_h, 0.0, 1.0)
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * share))


def chunk_edges(holds: Sequence[Hold], row_count: int, row_period_s: float) -> NDArray[np.int64]:
    """Return the rows, counted from the start of operation, at which one commanded piece ends and the next begins."""
    slews = [
        (start_h * 3600.0, (start_h + hold.slew_min / 60.0) * 3600.0)
        for hold in holds
        for start_h in (hold.start_h, hold.start_h + hold.hold_h)
    ]
    corners = sorted({0.0, row_count * row_period_s, *(corner for slew in slews for corner in slew)})
    edges: set[int] = set()
    for begin_s, end_s in pairwise(corners):
        middle_s = 0.5 * (begin_s + end_s)
        is_slew = any(first_s < middle_s < last_s for first_s, last_s in slews)
        count = int(np.ceil((end_s - begin_s) / (SLEW_CHUNK_S if is_slew else HOLD_CHUNK_S)))
        edges.update(int(row) for row in np.round(np.linspace(begin_s, end_s, count + 1) / row_period_s))
    return np.array(sorted(edge for edge in edges if 0 <= edge <= row_count), dtype=np.int64)
