"""Events of a scenario, as data: what happens, to whom, when.

Hours count from the start of the operation phase. What an event leaves open (a time, a carrier, a size) is drawn from
the stream named after the event, so that adding one event changes no other.
"""

from dataclasses import dataclass

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
