"""Events of a scenario, as data: what happens, to whom, when.

Hours count from the start of the operation phase. What an event leaves open (a time, a carrier, a size) is drawn from
the stream named after the event, so that adding one event changes no other.
"""

from dataclasses import dataclass

#: low and high end of a uniform draw; equal ends fix the value
Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Hold:
    """The craft slews to an attitude, stays and slews back to zero."""

    start_h: float
    #: from the start of the slew out to the start of the slew back
    hold_h: float
    slew_min: float = 20.0
    yaw_deg: float = 0.0
    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    #: whether the ground was told by corrections
    is_announced: bool = True


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


@dataclass(frozen=True, slots=True)
class ChainStep:
    """The receiving chain steps by a signed amount, all carriers together (recalibration, switching)."""

    name: str
    start_h: Range = (12.0, 12.0)
    size_db: Range = (0.5, 0.5)


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


Fault = UplinkRain | DownlinkRain | SwitchOff | Step | GroupStep | ChainStep | Interference | Gap
Manoeuvre = Hold | Tour
