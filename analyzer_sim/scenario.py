"""Scenarios: the story a world tells, as data.

A scenario is a plan of phases, figures of noise and attitude keeping, and a list of events. Phases follow one another:
`quiet` (star tracker on, harmonics are learned), `turns` (star tracker on, the craft is turned by the timetable of
`turns.py`), `alignment` (star tracker on, nominal attitude), `operation` (star tracker off).
"""

from dataclasses import dataclass, field, replace

from analyzer_sim.epochs import US_PER_H, US_PER_S, epoch_us_from_text
from analyzer_sim.events import (
    ChainStep,
    DownlinkRain,
    Fault,
    Gap,
    GroupStep,
    Interference,
    Manoeuvre,
    Step,
    SwitchOff,
    Tour,
    UplinkRain,
)
from analyzer_sim.turns import TURNS_H

DEFAULT_START_US = epoch_us_from_text("2026-11-01T00:00:00Z")


@dataclass(frozen=True, slots=True)
class NoiseFigures:
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


@dataclass(frozen=True, slots=True)
class KeepingFigures:
    """How the attitude is kept; triples in the order yaw, roll, pitch."""

    #: limit cycle under the star tracker, deg
    tracker_deg: tuple[float, float, float] = (0.025, 0.018, 0.018)
    tracker_tau_s: float = 7200.0
    #: error of the angles from which corrections are computed in operation, deg
    knowledge_deg: tuple[float, float, float] = (0.105, 0.038, 0.052)
    knowledge_tau_s: float = 3 * 3600.0
    #: time in which a correction removes the known deviation
    feedback_tau_s: float = 1.5 * 3600.0
    #: drift of the inertial model, deg/h
    drift_deg_h: tuple[float, float, float] = (0.04, 0.025, 0.025)
    drift_tau_s: float = 8 * 3600.0
    #: error of the effect of a correction, one sigma, relative
    scale_error: float = 0.015
    #: whether roll and yaw exchange with the orbital rate
    is_coupled: bool = True


@dataclass(frozen=True, slots=True)
class Phase:
    """One stretch of the story, [start, stop)."""

    name: str
    start_us: int
    stop_us: int
    is_tracker_on: bool


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
    noise: NoiseFigures = field(default_factory=NoiseFigures)
    keeping: KeepingFigures = field(default_factory=KeepingFigures)
    manoeuvres: tuple[Manoeuvre, ...] = ()
    faults: tuple[Fault, ...] = ()

    @property
    def row_period_us(self) -> int:
        """Time between rows, microseconds."""
        return round(self.row_period_s * US_PER_S)

    @property
    def phases(self) -> tuple[Phase, ...]:
        """The phases in order; each begins where the one before it ends."""
        durations_h = (self.quiet_h, TURNS_H, self.alignment_h, self.operation_h)
        phases, start_us = [], self.start_us
        for name, duration_h in zip(("quiet", "turns", "alignment", "operation"), durations_h, strict=True):
            stop_us = start_us + round(duration_h * US_PER_H)
            phases.append(Phase(name, start_us, stop_us, is_tracker_on=name != "operation"))
            start_us = stop_us
        return tuple(phases)

    @property
    def operation_start_us(self) -> int:
        """Epoch from which the star tracker is off."""
        return self.phases[-1].start_us

    @property
    def stop_us(self) -> int:
        """First epoch after the story."""
        return self.phases[-1].stop_us


#: attitude kept closely enough for an announced tour to stay within 0.42 deg
_CLOSE_KEEPING = KeepingFigures(knowledge_deg=(0.018, 0.012, 0.014), feedback_tau_s=0.5 * 3600.0, scale_error=0.01)
_TOUR = Tour("tour")


def downlink_rain(
    slope_db_min: float, depth_db: float, duration_min: float = 60.0, name: str = "downlink_rain"
) -> Scenario:
    """Return two days with one rain over the receiving site of this slope and depth."""
    rain = DownlinkRain(
        "downlink rain",
        depth_db=(depth_db, depth_db),
        slope_db_min=(slope_db_min, slope_db_min),
        duration_min=(duration_min, duration_min),
    )
    summary = f"Rain over the receiving site: all carriers fade by {depth_db:g} dB at {slope_db_min:g} dB/min."
    return Scenario(name, summary, faults=(rain,))


#: slope, dB/min, and depth, dB, of the rains in the catalogue beside the plain one
_RAINS = ((0.02, 2.0), (0.05, 3.0), (0.3, 4.0), (1.0, 5.0), (3.0, 6.0))

_CATALOGUE = (
    Scenario("nominal", "Two days of ordinary keeping, no fault."),
    Scenario(
        "demo",
        "A tour of all octants by 0.2-0.33 deg with mild uplink rain and one carrier off for some hours.",
        keeping=_CLOSE_KEEPING,
        manoeuvres=(_TOUR,),
        faults=(
            UplinkRain(
                "mild rain",
                3,
                ("c02", "c07", "c13"),
                depth_db=(1.0, 2.5),
                slope_db_min=(0.05, 0.3),
                start_h=(3.0, 40.0),
            ),
            SwitchOff("carrier off", ("c05",), start_h=(12.0, 14.0), duration_h=(4.0, 6.0)),
        ),
    ),
    Scenario(
        "octants",
        "A tour of all octants by 0.1-0.4 deg, no fault.",
        keeping=_CLOSE_KEEPING,
        manoeuvres=(replace(_TOUR, yaw_deg=(0.1, 0.4), roll_deg=(0.1, 0.4), pitch_deg=(0.1, 0.4)),),
    ),
    Scenario("steps", "Six users change their level for good.", faults=(Step("steps", 6),)),
    Scenario("uplink_rain", "Ten showers over users' stations.", faults=(UplinkRain("showers", 10),)),
    downlink_rain(0.1, 3.0),
    *(downlink_rain(slope, depth, name=f"downlink_rain_{slope:g}".replace(".", "p")) for slope, depth in _RAINS),
    Scenario(
        "mixed",
        "Four days with every kind of fault.",
        operation_h=96.0,
        faults=(
            UplinkRain("showers", 8, start_h=(1.0, 94.0)),
            DownlinkRain("downlink rain", (20.0, 40.0), (1.5, 5.0), (0.03, 0.5), (30.0, 150.0)),
            Step("steps", 4, start_h=(1.0, 94.0)),
            SwitchOff("carrier off", start_h=(10.0, 80.0), level_after_db=(-1.0, 1.5)),
            GroupStep("transponder", start_h=(45.0, 70.0)),
            ChainStep("recalibration", (75.0, 85.0), (-0.6, 0.6)),
            Interference("interference", 2, start_h=(1.0, 90.0)),
            Gap("gap", 2, start_h=(5.0, 90.0)),
        ),
    ),
    Scenario(
        "white",
        "White noise only, of the sizes of the plan; no drift of the chain.",
        noise=NoiseFigures(coloured_db=(0.0, 0.0), chain_db=0.0, chain_daily_db=0.0, thermal_db=0.0, wander_scale=0.0),
    ),
    Scenario("gaps", "Six gaps of ten minutes to three hours.", faults=(Gap("gaps", 6),)),
)

#: every scenario by name
SCENARIOS: dict[str, Scenario] = {scenario.name: scenario for scenario in _CATALOGUE}


def scenario_named(
    name: str,
    *,
    operation_days: float | None = None,
    row_period_s: float | None = None,
    start_us: int | None = None,
) -> Scenario:
    """Return a scenario of the catalogue, with another length, row period or start where one is given.

    Raises
    ------
    KeyError
        No scenario has this name; the message lists those that exist.
    """
    if name not in SCENARIOS:
        raise KeyError(f"no scenario {name!r}; there are {', '.join(sorted(SCENARIOS))}")
    chosen = SCENARIOS[name]
    return replace(
        chosen,
        operation_h=chosen.operation_h if operation_days is None else 24.0 * operation_days,
        row_period_s=chosen.row_period_s if row_period_s is None else row_period_s,
        start_us=chosen.start_us if start_us is None else start_us,
    )
