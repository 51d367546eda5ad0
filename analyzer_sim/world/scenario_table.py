"""Tables of the scenarios and of the carrier plans: what `python -m analyzer_sim scenarios` prints."""

from collections.abc import Callable, Iterator

from analyzer_sim.world.orbit import Orbit
from analyzer_sim.world.payload.carriers import PLANS, CarrierPlan
from analyzer_sim.world.payload.level_terms import sensitivity_db_per_deg
from analyzer_sim.world.scenario.events import (
    ChainStep,
    Eclipse,
    Fault,
    GroupStep,
    PlanChange,
    SourceSwitch,
    SunOutage,
    SwitchOff,
)
from analyzer_sim.world.scenario.scenario import SCENARIOS
from analyzer_sim.world.scenario.story import DEFAULT_START_US, Scenario
from analyzer_sim.world.structure import crlb_deg
from analyzer_sim.world.world import LONGITUDE_DEG

_SCENARIO_HEAD = "| scenario | days | plan | row | what happens | the ground is also told |\n|---|---|---|---|---|---|"
_PLAN_HEAD = (
    "| plan | carriers | bands | transponders | yaw, deg | roll, deg | pitch, deg |\n|---|---|---|---|---|---|---|"
)

#: what the ground is told of an event, if it is
_REPORTED: dict[type[Fault], Callable[[Fault], str]] = {
    SwitchOff: lambda fault: "carrier_work" if isinstance(fault, SwitchOff) and fault.is_announced else "",
    GroupStep: lambda fault: "gain_change" if isinstance(fault, GroupStep) and fault.is_announced else "",
    ChainStep: lambda fault: "receive_chain_work" if isinstance(fault, ChainStep) and fault.is_announced else "",
    Eclipse: lambda _fault: "eclipse",
    SunOutage: lambda _fault: "sun_outage",
    PlanChange: lambda _fault: "new plan",
    SourceSwitch: lambda _fault: "which analyzer measures",
}


def plain_table() -> str:
    """Return one line a scenario."""
    width = max(len(name) for name in SCENARIOS)
    return "\n".join(f"{name:<{width}}  {scenario.summary}" for name, scenario in SCENARIOS.items()) + "\n"


def markdown_tables() -> str:
    """Return the tables of scenarios and carrier plans of ``docs/evidence/scenarios.md``."""
    return "\n".join([_SCENARIO_HEAD, *_scenario_rows(), "", _PLAN_HEAD, *_plan_rows()]) + "\n"


def reported(scenario: Scenario) -> str:
    """Return what the ground learns beside references and corrections; a dash for nothing."""
    kinds = [_REPORTED[type(fault)](fault) for fault in scenario.faults if type(fault) in _REPORTED]
    for burn in scenario.burns:
        delay = f"{burn.ephemeris_after_h:g} h after the burn" if burn.ephemeris_after_h else "with the burn"
        kinds += ["station_keeping", f"new ephemeris {delay}"]
    if scenario.pause_h > 0.0:
        kinds.append("new ephemeris after the pause")
    kinds += _reported_statistics(scenario)
    return ", ".join(dict.fromkeys(kind for kind in kinds if kind)) or "-"


def _reported_statistics(scenario: Scenario) -> list[str]:
    """Return what the ground learns by catalogue and habit."""
    kinds, figures = [], scenario.repeater
    if figures.alc_transponders:
        kinds.append("catalogue: transponder_mode alc")
    if figures.power_controlled:
        kinds.append(f"catalogue: uplink_power_control {'auto' if figures.is_power_control_announced else 'unknown'}")
    if not scenario.keeping.is_coupled:
        kinds.append(f"catalogue: roll_yaw_coupling {str(scenario.keeping.is_coupling_announced).lower()}")
    if scenario.wheels is not None:
        kinds.append(f"wheel momentum each {scenario.wheels.period_min:g} min")
    if scenario.rates is not None:
        kinds.append("body rates each row")
    if scenario.polarimeter is not None:
        kinds.append("polarisation with each row, electron content")
    if scenario.keeping.corrections_late_min is not None:
        kinds.append(f"corrections {scenario.keeping.corrections_late_min:g} min after their end")
    return kinds


def _scenario_rows() -> Iterator[str]:
    for name, scenario in SCENARIOS.items():
        days, row = f"{scenario.operation_h / 24.0:g}", f"{scenario.row_period_s:g} s"
        yield f"| `{name}` | {days} | {scenario.plan} | {row} | {scenario.summary} | {reported(scenario)} |"


def _plan_rows() -> Iterator[str]:
    orbit = Orbit.drawn(1, LONGITUDE_DEG, DEFAULT_START_US)
    for plan in PLANS.values():
        bound = " | ".join(f"{angle:.3f}" for angle in crlb_deg(sensitivity_db_per_deg(plan, orbit)))
        yield f"| {plan.name} | {len(plan.carriers)} | {_bands(plan)} | {len(plan.beams)} | {bound} |"


def _bands(plan: CarrierPlan) -> str:
    return ", ".join(dict.fromkeys(carrier.band for carrier in plan.carriers))
