"""Table of the scenarios and of the carrier plans: what `python -m analyzer_sim scenarios` prints."""

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

#: where the table is kept, and what keeps it there
MARKDOWN_COMMAND = "python -m analyzer_sim scenarios --markdown"

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


def markdown_page() -> str:
    """Return the reference page of the scenarios."""
    return "\n".join([*_HEAD, *_scenario_rows(), *_PLAN_HEAD, *_plan_rows(), *_FOOT]) + "\n"


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


_HEAD = (
    "# Scenarios of the simulated analyzer",
    "",
    f"Made by `{MARKDOWN_COMMAND}`; a test keeps it current.",
    "",
    "A scenario and a seed make a world: `soo-analyzer serve --scenario NAME --seed N` lets it be measured through",
    "SCPI, `soo-analyzer export --scenario NAME --seed N --out F.npz` writes the same world as arrays.",
    "`--operation-days`, `--row-period` and `--start` change length, cadence and first epoch of any of them. Each has",
    "three quiet days, the turns of 8.5 h and an hour of alignment before its operation phase, whose length is given.",
    "The ground always knows references (until the operation phase, of a star tracker unless said otherwise), hourly",
    "telemetry and announced corrections; the last column names what else it is told.",
    "",
    "| scenario | days | plan | row | what happens | the ground is also told |",
    "|---|---|---|---|---|---|",
)
_PLAN_HEAD = (
    "",
    "## Carrier plans",
    "",
    "Bound (CRLB) of the angles from one row with 0.1857 dB of noise a carrier and an unknown common to all of them;",
    "published figures: 1.46/0.061/0.209 deg for 8 carriers, 1.01/0.044/0.144 for 16, 0.77/0.035/0.108 for 32.",
    "",
    "| plan | carriers | bands | transponders | yaw, deg | roll, deg | pitch, deg |",
    "|---|---|---|---|---|---|---|",
)
_FOOT = (
    "",
    "## Closed loops",
    "",
    "`soo-analyzer plant --scenario NAME --seed N` flies the operation phase by torques: JSON lines on standard",
    "output, a schedule on standard input after each row of operation. The rows before it are those of the export.",
    "",
    '    {"type":"start","scenario","seed","carriers","open_rows","closed_rows","uplink","slowest_s",',
    '     "onboard","fed_forward_torque"}',
    '    {"type":"ground","line":{..}}          a line of the ground port, the story\'s corrections left out',
    '    {"type":"report","counter","state","told","received"[,"executed_from","executed_until","impulse_n_m_s"]}',
    '    {"type":"truth","epoch","yaw_deg","roll_deg","pitch_deg","rates_deg_s",..}   for the judge alone',
    '    {"type":"row","epoch","power_dbm"}     then, in operation, one line is read:',
    '    {"schedule":[{"start","duration_s","roll_n_m","pitch_n_m","yaw_n_m"}][,"counter"]',
    '     [,"attitude":{"counter","attitude_epoch","valid_until","attitude_deg":{..}}]}',
    '    {"type":"error","detail"}              the line was refused, nothing has changed, another one is read',
    '    {"type":"end"}',
    "",
    "`--uplink link` lets a schedule arrive after 30-120 s, loses 2 % and delivers 1 % twice; `ideal`, the default,",
    "delivers at once. A counter is executed once, in whatever order counters arrive: a second arrival is reported as",
    "`repeated`. A schedule of which an element should have begun before it arrived is left out as a whole (`late`);",
    "one that would fill a wheel is `refused`; what was flown is `executed`, as far as it was flown while more lies",
    "ahead `executing`; of what was lost nothing is told. From its first element on a schedule takes the place of all",
    "with a smaller counter: what of them has not begun by then is left out, what is in flight ends there; if nothing",
    "is left it is `replaced`. Torques are rounded to whole quanta of 2 mN m. `rates_deg_s` is the rate that torques",
    "have given.",
    "",
    "The body (2600, 1400, 2600 kg m2 about roll, pitch, yaw) obeys Euler's equations with the momentum stored in its",
    "wheels, whose bearings rub and whose drives move in quanta. The loop on board holds the rate of an inertial model",
    "every 2 s; the model drifts as the story says and does not see the twentieth of the Sun's torque (some 1e-5 N m)",
    "that is not fed forward, so these two move the spacecraft. Before each row a `telemetry` line tells momentum and",
    "speed of the wheels and the model rate. `--onboard perfect` takes the loop as perfect, integrates exactly and",
    "lets torques of any size act. `--response roll=-1` turns what a command does round, `--tone roll:0.6:0.003:0.4`",
    "adds a flexible mode that moves the hub. `--scenario slew_fade` is for closed loops alone: roll and pitch begin",
    "0.35 deg off, and 20 min into the slew to zero all carriers fade by 2 dB at 0.3 dB/min for an hour. So are",
    "`unknown_residual_constant` and `unknown_residual_daily`: the Sun's torque is fed forward as a whole, and a",
    "torque of 2e-7 to 2e-6 N m about each axis, constant or a wave of a day, is not; the catalogue knows of neither",
    "(`residual_torque_n_m` and `fed_forward_torque` null). In `plant_varied` the seed draws the shape of that torque",
    "(constant, daily, or constant and gone for 72 min in the Earth's shadow), the stated inertia within 10 % of the",
    "true one, rows of 10 to 300 s, and the slowest way of a command, 60 to 900 s; each unloading, at midnight and",
    "noon, leaves 5e-4 N m s about each axis, which nobody announces.",
    "",
    "`--age-limit S` flies a loop on board that takes angles, as `GET .../attitude/uplink` gives them, in place of",
    "torques: the angles pass the same uplink, each counter is taken once and in order, none after its `valid_until`.",
    "Between products the spacecraft carries its angles on with the rate that its torques have given and a bias that",
    "it learns. Beyond the age limit it holds: it takes away the rate that it knows of and nothing else, until the",
    "next product. What it executes is reported as any command; `truth` tells `is_holding`.",
    "",
    "`soo-analyzer --scenario NAME --uplink-port 0` serves the same spacecraft behind the SCPI port, with `--uplink`,",
    "`--onboard`, `--response` and `--tone` of `plant`. It announces `uplink_port`, a TCP port of JSON lines.",
    "It takes the schedule line above at any time once the first row of operation has been swept, and sends it at the",
    "epoch of the newest row; each sweep flies the spacecraft to its row. It tells:",
    "",
    '    {"type":"start","scenario","seed","uplink","onboard","operation_start","fed_forward_torque"}',
    '    {"type":"taken","counter","sent"}      the answer to a schedule; counter null = nothing to send',
    '    {"type":"report",..}                   as above',
    '    {"type":"flown","epoch"}               the spacecraft has come to this row; its reports came before this line',
    '    {"type":"error","detail"}              the line was refused, nothing has changed',
    "",
    "One client holds the port; reports that nobody heard are told to the next one. 100 schedules a row are taken. On",
    "the ground port each hold of operation then lets one row be swept; its telemetry and truth follow it.",
    "",
    "## Simplifications",
    "",
    "* The beams are invented, wide enough for the published 1.2 dB/deg. Polarization is measured in `polarized` and",
    "  its kin alone: turn about the line of sight, leakage of the feed, Faraday rotation, rain over the site.",
    "* Roll and yaw exchange kinematically. Where torques act, in `plant` and with an uplink, no manoeuvre is flown.",
    "* Telemetry is for show where no torque is flown: wheel momentum and mode act on nothing. In `wheels` and its",
    "  kin it is that of the attitude, told with the errors of axes, scale, noise and one rpm. The torque from outside",
    "  gathers in the wheels and moves nothing: the loop on board takes it whole away. In `plant` it goes on, without",
    "  what no profile states, and a twentieth of it moves the body.",
    "* In `rates` and its kin telemetry has the inertial rate of the body, the mean since the row before, with a bias",
    "  and an angle random walk about each axis; the axes of the sensor are those of the body.",
    "* The loop on board takes gyroscopic torques away with the true rate; flexible modes do not act back on it.",
    "* Noise is written row by row: a row of 10 s has the white noise of a row of 300 s.",
    "* A pause is passed over: noise goes on after it as if it had not been.",
    "* `eclipse` has its shadow in the operation phase only, not on the quiet days before it.",
    "* In `dual_band` both bands share one span and one noise density, that of the band which rain raises.",
    "* The levels of `flicker` stand on multiples of 0.15 dB before the sweep adds its noise; `--sweep-noise 0` keeps",
    "  the grid in an export.",
    "* The ground port sends what the ground learns with the chunk of rows in which it does, so up to a chunk early.",
)


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
