"""Plant: a spacecraft that answers torque schedules, and the lines by which it takes them.

Lines of the plant: the dialogue over a pair of text streams, one JSON object a line.

Out, in this order; fields in brackets are not always there:

    {"type":"start","scenario":..,"seed":..,"carriers":[ids],"open_rows":n,"closed_rows":m,"uplink":..,"slowest_s":..,
     "onboard":..,"fed_forward_torque":{"epoch":..,"period_s":..,"constant_n_m":{..},"cosine_n_m":{..},"sine_n_m":{..}}}
    {"type":"ground","line":{..}}                what the ground port would send, corrections left out
    {"type":"report","counter":..,"state":"executed|executing|replaced|repeated|late|refused","told":..,"received":..,
     ["executed_from":..,"executed_until":..,"impulse_n_m_s":{..}]}
    {"type":"truth","epoch":..,"yaw_deg":..,..}  for the judge alone
    {"type":"row","epoch":..,"power_dbm":[..]}   null = absent; rows of a gap are left out
    {"type":"end"}

Quiet phase, turns and alignment run through without an answer. In operation each row is preceded by a telemetry
record of its own (a ``ground`` line: momentum and speed of the wheels, rate of the body as the model on board has it)
and by the reports of commands since the row before; of a command that was lost there is none. After each row of
operation the plant waits for one line

    {"schedule":[{"start":..,"duration_s":..,"roll_n_m":..,"pitch_n_m":..,"yaw_n_m":..},..],["counter":..],
     ["attitude":{"counter":..,"attitude_epoch":..,"valid_until":..,"attitude_deg":{..}}]}

An attitude is for the loop on board of `--age-limit`. Elements begin not before the row. Without a counter the plant
counts the schedules that are not empty. A line that is not understood is answered by `{"type":"error","detail":..}`,
changes nothing, and another one is awaited. The end of standard input ends the plant.
"""

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple, TextIO

import numpy as np

from analyzer_sim.epochs import US_PER_S, epoch_us_from_text, rfc3339
from analyzer_sim.export import measured_dbm, sweep_noise_db
from analyzer_sim.streams import FloatArray, stream
from analyzer_sim.world.ground.ground import (
    TORQUE_LIMIT_N_M,
    catalogue_lines,
    chunks_of,
    flown_lines,
    reported_lines,
    truth_row,
)
from analyzer_sim.world.orbit import EARTH_RATE_RAD_S
from analyzer_sim.world.scenario.story import Scenario
from analyzer_sim.world.spacecraft import body, telemetry
from analyzer_sim.world.spacecraft.hub_tones import HubTone
from analyzer_sim.world.spacecraft.uplink import (
    UPLINKS,
    Angles,
    AnglesLoop,
    Arrival,
    Command,
    CommandStore,
    Report,
    Uplink,
)
from analyzer_sim.world.world import World

#: longest line, elements of one schedule, duration of one element, s, and largest counter
MAX_LINE_CHARACTERS = 1_000_000
MAX_ELEMENTS = 10_000
MIN_DURATION_S, MAX_DURATION_S = 1e-6, 86_400.0
MAX_COUNTER = 2**32 - 1
MAX_ANGLE_DEG = 180.0
_ANGLE_FIELDS = {"counter", "attitude_epoch", "valid_until", "attitude_deg"}
_FIELDS = {"start", "duration_s", "roll_n_m", "pitch_n_m", "yaw_n_m"}


class ScheduleError(ValueError):
    """A line holds no valid schedule; the text gives the reason."""


class Schedule(NamedTuple):
    """Torque schedule of one line of the uplink protocol."""

    elements: tuple[body.TorqueElement, ...]
    #: None = the plant counts
    counter: int | None = None
    #: for the loop on board
    angles: Angles | None = None


def parse_schedule(text: str, not_before_us: int) -> Schedule:
    """Return the schedule of a line.

    Raises
    ------
    ScheduleError
        Too long, not JSON, not a schedule, an element that begins before `not_before_us` or exceeds a limit.
    """
    if len(text) > MAX_LINE_CHARACTERS:
        raise ScheduleError(f"a line holds at most {MAX_LINE_CHARACTERS} characters")
    try:
        # an integer of a thousand digits is infinite, not an error
        message = json.loads(text, parse_int=float)
    except (ValueError, RecursionError):
        raise ScheduleError("a line is one JSON object") from None
    if not isinstance(message, dict) or not {"schedule"} <= set(message) <= {"schedule", "counter", "attitude"}:
        raise ScheduleError('a line is {"schedule": [..]}, perhaps with a counter or an attitude, and nothing else')
    reported = message["schedule"]
    if not isinstance(reported, list):
        raise ScheduleError("the schedule is a list of elements")
    if len(reported) > MAX_ELEMENTS:
        raise ScheduleError(f"a schedule holds at most {MAX_ELEMENTS} elements")
    elements = tuple(_element(k, item, not_before_us) for k, item in enumerate(reported))
    counter = _counter(message["counter"]) if "counter" in message else None
    return Schedule(elements, counter, _angles(message["attitude"]) if "attitude" in message else None)


def _angles(item: object) -> Angles:
    """Return the angles of a line, fields as in `attitude/uplink`."""
    if not isinstance(item, dict) or not set(item) >= _ANGLE_FIELDS or not isinstance(item["attitude_deg"], dict):
        raise ScheduleError(f"an attitude has {', '.join(sorted(_ANGLE_FIELDS))}")
    reported = [item["attitude_deg"].get(axis, math.nan) for axis in ("yaw", "roll", "pitch")]
    # null says that the ground withholds the axis
    if not all(angle is None or (isinstance(angle, float) and abs(angle) <= MAX_ANGLE_DEG) for angle in reported):
        raise ScheduleError(f"attitude_deg holds yaw, roll and pitch within {MAX_ANGLE_DEG:g} deg, or null")
    yaw, roll, pitch = (math.nan if angle is None else angle for angle in reported)
    epoch_us, until_us = (_epoch_us("attitude", name, item[name]) for name in ("attitude_epoch", "valid_until"))
    return Angles(_counter(item["counter"]), epoch_us, until_us, (yaw, roll, pitch))


def _counter(value: object) -> int:
    if not isinstance(value, float) or not 0.0 <= value <= MAX_COUNTER or not value.is_integer():
        raise ScheduleError(f"the counter is a whole number of 0..{MAX_COUNTER}")
    return int(value)


def _element(number: int, item: object, not_before_us: int) -> body.TorqueElement:
    if not isinstance(item, dict) or set(item) != _FIELDS:
        raise ScheduleError(f"element {number}: the fields are {', '.join(sorted(_FIELDS))}")
    duration_s = _number(number, item, "duration_s")
    if not MIN_DURATION_S <= duration_s <= MAX_DURATION_S:
        raise ScheduleError(f"element {number}: duration_s lies outside {MIN_DURATION_S:g}..{MAX_DURATION_S:g}")
    start_us = _epoch_us(f"element {number}", "start", item["start"])
    if start_us < not_before_us:
        raise ScheduleError(f"element {number}: it begins before the row of {rfc3339(not_before_us)}")
    yaw, roll, pitch = (_number(number, item, f"{axis}_n_m") for axis in ("yaw", "roll", "pitch"))
    if max(abs(yaw), abs(roll), abs(pitch)) > TORQUE_LIMIT_N_M:
        raise ScheduleError(f"element {number}: a torque exceeds {TORQUE_LIMIT_N_M:g} N m")
    return body.TorqueElement(start_us, start_us + round(duration_s * US_PER_S), (yaw, roll, pitch))


def _number(number: int, item: dict[str, object], name: str) -> float:
    value = item[name]
    if not isinstance(value, float) or not math.isfinite(value):
        raise ScheduleError(f"element {number}: {name} is not a finite number")
    return value


def _epoch_us(what: str, name: str, text: object) -> int:
    try:
        return epoch_us_from_text(str(text))
    except (ValueError, OverflowError):
        raise ScheduleError(f"{what}: {name} is no RFC 3339 epoch with a zone") from None


@dataclass(frozen=True, slots=True)
class PlantOptions:
    """Options of the simulated spacecraft and of its uplink."""

    #: name of the channel in ``UPLINKS``
    uplink: str = "ideal"
    #: "wheels": the loop on board is flown; "perfect": it is taken as perfect and the body is integrated exactly
    onboard: str = "wheels"
    #: what a commanded torque does about roll, pitch, yaw: 1 = what it says, -1 = the opposite, 0 = nothing
    response: body.Vector = (1.0, 1.0, 1.0)
    tones: tuple[HubTone, ...] = ()
    #: the loop on board takes angles in place of torques, none older than this, s; None = it takes torques
    age_limit_s: float | None = None


class Plant:
    """A world whose attitude follows from torques once operation has begun.

    Parameters
    ----------
    scenario : Scenario
        The story; its manoeuvres are not flown.
    seed : int
        Seed of every named stream.
    sweep_noise : float
        Scale of the stand-in for the sweep's own noise.
    options : PlantOptions, optional
        OrbitalFrameSpacecraft and channel.

    Attributes
    ----------
    options : PlantOptions
        OrbitalFrameSpacecraft and channel.
    world : World
        Rows before operation are its rows, to the last bit.
    row : int
        Index of the present row.
    state : BodyState
        Attitude and rates at the present row.
    reports : list of Report
        What the spacecraft has told between the row before and the present one.
    """

    def __init__(
        self, scenario: Scenario, seed: int, sweep_noise: float = 1.0, options: PlantOptions | None = None
    ) -> None:
        self.options = options = options or PlantOptions()
        self.world = World(scenario, seed)
        self._epochs_us = self.world.rows.epochs_us
        self.first_row = int(np.searchsorted(self._epochs_us, scenario.operation_start_us))
        self.row = self.first_row
        self._noise_db = sweep_noise_db(self.world, sweep_noise)
        self.open_dbm = measured_dbm(self.world, sweep_noise)[: self.first_row]
        self._attitude_deg = self.world.rows.attitude_deg.copy()
        self._disturbance = telemetry.disturbance(scenario, seed, self._epochs_us[self.first_row :])
        self.reports: list[Report] = []
        is_perfect = options.onboard == "perfect"
        self.uplink = Uplink(UPLINKS[options.uplink].within(scenario.keeping.slowest_uplink_s), seed)
        self._store = CommandStore(0.0 if is_perfect else body.QUANTUM_N_M)
        self._acting: list[body.TorqueElement] = []
        self._counter = 0
        self.flown: body.OrbitalFrameSpacecraft = self._spacecraft(options)
        roll, pitch, yaw = body.INERTIA_KG_M2
        coupling = EARTH_RATE_RAD_S if scenario.keeping.is_coupled else 0.0
        self._perfect = body.RigidBody((yaw, roll, pitch), coupling) if is_perfect else None
        self.state: body.BodyState = self.flown.state
        limit_s = options.age_limit_s
        self.loop = None if limit_s is None else AnglesLoop((yaw, roll, pitch), coupling, limit_s)

    @property
    def row_count(self) -> int:
        """Rows of the whole story."""
        return len(self._epochs_us)

    @property
    def epoch_us(self) -> int:
        """Epoch of the present row."""
        return int(self._epochs_us[self.row])

    @property
    def is_measured(self) -> bool:
        """Return whether the present row is measured at all."""
        return not self.world.rows.is_gap[self.row]

    @property
    def momentum_n_m_s(self) -> body.Vector:
        """Momentum of the wheels along roll, pitch, yaw."""
        roll, pitch, yaw = (wheel.momentum_n_m_s for wheel in self.flown.wheels)
        return roll, pitch, yaw

    def power_dbm(self) -> FloatArray:
        """Return the measured powers (N,) of the present row at the attitude flown, NaN = absent."""
        # power control remembers, so that its rows are computed from the first one on
        first = 0 if self.world.terms.has_control else self.row
        levels = self.world.terms.levels(self._attitude_deg[first : self.row + 1], first)
        power_dbm = self.world.terms.measurable_dbm(levels.carrier_dbm, first)
        return np.asarray(power_dbm[-1] + self._noise_db[self.row])

    def advance(self, schedule: Schedule) -> bool:
        """Send a schedule and fly to the next row; False after the last row."""
        if self.row + 1 >= self.row_count:
            return False
        begin_us, end_us = self.epoch_us, int(self._epochs_us[self.row + 1])
        self.send(schedule)
        self._receive(begin_us, end_us)
        self._fly(begin_us, end_us)
        self.reports = sorted([*self.reports, *self._store.ended(end_us)])
        self.row += 1
        self._attitude_deg[self.row] = self.state.attitude_deg
        return True

    def send(self, schedule: Schedule) -> int | None:
        """Hand a schedule to the channel at the present row; None = nothing is sent where nothing is wanted."""
        if self.loop is not None and schedule.angles is not None:
            self.uplink.send(Command(schedule.angles.counter, ()), self.epoch_us, schedule.angles)
        if schedule.counter is None and not schedule.elements:
            return None
        counter = self._counter + 1 if schedule.counter is None else schedule.counter
        self._counter = max(self._counter, counter)
        self.uplink.send(Command(counter, schedule.elements), self.epoch_us)
        return counter

    def _receive(self, begin_us: int, end_us: int) -> None:
        """Let the spacecraft take what arrives before the next row."""
        self.reports = []
        roll, pitch, yaw = self.momentum_n_m_s
        arrivals = self.uplink.arrivals(end_us)
        if self.loop is not None:
            for angles, received_us in ((a.angles, a.received_us) for a in arrivals):
                if angles is not None:
                    self.loop.consume(angles, received_us)
            arrivals = [arrival for arrival in arrivals if arrival.angles is None]
            elements = self.loop.command((begin_us, end_us), self._given_deg_s())
            if elements:
                self._counter += 1
                arrivals.append(Arrival(begin_us, Command(self._counter, elements)))
        for arrival in arrivals:
            report, _ = self._store.receive(arrival, (yaw, roll, pitch))
            self.reports += [] if report is None else [report]
        self._acting = self._store.acting(begin_us)

    def _given_deg_s(self) -> body.Triple:
        """Return the rate that torques have given as the inertial model has it: without what it does not see."""
        if self._perfect is not None:
            return self.state.rate_deg_s
        x, y, z = (math.degrees(rate) for rate in self.flown.commanded_rad_s)
        return z, x, y

    def _fly(self, begin_us: int, end_us: int) -> None:
        step = self.row - self.first_row
        drift_deg_s, external_n_m, unseen_n_m = (_triple(series[step]) for series in self._disturbance)
        if self._perfect is None:
            self.flown.fly((begin_us, end_us), self._acting, drift_deg_s, external_n_m, unseen_n_m)
            self.state = self.flown.state
        else:
            self.state = self._perfect.fly(self.state, (begin_us, end_us), self._acting, drift_deg_s, unseen_n_m)
        self._unload(begin_us, end_us)

    def _unload(self, begin_us: int, end_us: int) -> None:
        """Let thrusters take away what the wheels hold beyond their bias, where the story says so for a span."""
        figures = self.world.scenario.wheels
        before, after = np.searchsorted(
            telemetry.unloadings_us(self.world.scenario), [begin_us, end_us], side="right"
        ).tolist()
        if figures is None or before == after:
            return
        left = telemetry.unloaded(figures, self.world.seed, after).tolist()
        for wheel, momentum in zip(self.flown.wheels, left, strict=True):
            wheel.momentum_n_m_s = momentum

    def _spacecraft(self, options: PlantOptions) -> body.OrbitalFrameSpacecraft:
        """Return the spacecraft as it stands when operation begins."""
        keeping, seed = self.world.scenario.keeping, self.world.seed
        wheels = body.wheel_set(seed, self.reported_telemetry().wheel_momentum_n_m_s or (0.0, 0.0, 0.0))
        attitude_deg = _triple(self._attitude_deg[self.first_row])
        flown = body.spacecraft_at_rest(body.INERTIA_KG_M2, attitude_deg, wheels, is_coupled=keeping.is_coupled)
        flown.response, flown.tones = options.response, options.tones
        return flown

    def reported_telemetry(self) -> telemetry.TelemetryRecord:
        """Return the story's newest record of the wheels at the present row."""
        reported = (one for one in self.world.telemetry if one.wheel_momentum_n_m_s is not None)
        return [record for record in reported if record.reported_us <= self.epoch_us][-1]


def _triple(values: FloatArray) -> body.Triple:
    first, second, third = (float(value) for value in values)
    return first, second, third


Line = dict[str, Any]

_AXES = ("yaw", "roll", "pitch")
_US_PER_H = 3_600_000_000


def run_plant(plant: Plant, source: TextIO, sink: TextIO) -> int:
    """Play a plant over a pair of text streams and return the exit status.

    Raises
    ------
    BrokenPipeError
        The reader has left.
    """
    _send(sink, _opening(plant))
    while True:
        _send(sink, _present(plant))
        schedule = _await_schedule(plant, source, sink) if plant.is_measured else Schedule(())
        if schedule is None:
            return 0
        if not plant.advance(schedule):
            _send(sink, iter([{"type": "end"}]))
            return 0


def _opening(plant: Plant) -> Iterator[Line]:
    """Yield everything before operation."""
    world, options = plant.world, plant.options
    rows = {"open_rows": plant.first_row, "closed_rows": plant.row_count - plant.first_row}
    what = {"uplink": options.uplink, "slowest_s": plant.uplink.figures.latency_s[1], "onboard": options.onboard}
    carriers = list(world.carrier_ids)
    reported = {"fed_forward_torque": fed_forward_line(world)}
    start = {"type": "start", "scenario": world.scenario.name, "seed": world.seed, "carriers": carriers}
    yield {**start, **rows, **what, **reported}
    yield from ({"type": "ground", "line": line} for line in catalogue_lines(world, is_flown=True))
    for first, last, phase in chunks_of(world):
        if phase != "operation":
            yield from ({"type": "ground", "line": line} for line in reported_lines(world, first, last))
            for row in range(first, last + 1):
                yield {"type": "truth", **truth_row(world, row, world.rows.attitude_deg[row])}
                yield _row_line(int(world.rows.epochs_us[row]), plant.open_dbm[row])


def fed_forward_line(world: World) -> Line | None:
    """Return the profile that the loop on board feeds forward, as the catalogue states one; None = it is not known."""
    if not world.scenario.is_torque_stated:
        return None
    reported = telemetry.fed_forward(world.scenario, world.seed)
    parts = {"constant_n_m": reported.constant_n_m, "cosine_n_m": reported.cosine_n_m, "sine_n_m": reported.sine_n_m}
    torques = {name: dict(zip(_AXES, part.tolist(), strict=True)) for name, part in parts.items()}
    return {"epoch": rfc3339(reported.epoch_us), "period_s": reported.period_s, **torques}


def _present(plant: Plant) -> Iterator[Line]:
    """Yield what belongs to the present row of operation."""
    yield from ({"type": "ground", "line": line} for line in flown_lines(plant.world, plant.row, plant.row))
    yield {"type": "ground", "line": {"kind": "telemetry", "body": {"records": [telemetry_of(plant)]}}}
    yield from (report_line(report) for report in plant.reports)
    rates = dict(zip(_AXES, plant.state.rate_deg_s, strict=True))
    truth = truth_row(plant.world, plant.row, plant.state.attitude_deg)
    held = {} if plant.loop is None else {"is_holding": plant.loop.is_holding(plant.epoch_us)}
    yield {"type": "truth", **truth, "rates_deg_s": rates, **held}
    if plant.is_measured:
        yield _row_line(plant.epoch_us, plant.power_dbm())


def telemetry_of(plant: Plant) -> Line:
    """Return what the spacecraft says of itself; its inertial model does not see the drift of its rate."""
    reported = plant.reported_telemetry()
    x, y, z = (math.degrees(rate) for rate in plant.flown.commanded_rad_s)
    return {
        "epoch": rfc3339(plant.epoch_us),
        "onboard_mode": reported.onboard_mode,
        **_momentum_of(plant),
        "body_rate_deg_s": {"yaw": round(z, 9), "roll": round(x, 9), "pitch": round(y, 9)},
    }


def _momentum_of(plant: Plant) -> Line:
    """Return what the spacecraft says of its wheels: with each row, or as often as the story says."""
    momentum, reported, figures = plant.momentum_n_m_s, plant.reported_telemetry(), plant.world.scenario.wheels
    is_active = reported.thrusters_active
    if figures is None:
        is_active = is_active and plant.epoch_us - reported.reported_us < telemetry.PERIOD_H * _US_PER_H // 2
    elif reported.reported_us != plant.epoch_us:
        return {}
    else:
        noise = stream(plant.world.seed, "wheel noise", str(plant.row)).normal(size=3)
        momentum = telemetry.with_errors(figures, plant.world.seed, np.array(momentum), noise).tolist()
    return {
        "wheel_momentum_n_m_s": [round(h, 6) for h in momentum],
        "wheel_speed_rpm": [round(body.rotor_speed_rpm(h), 3) for h in momentum],
        "thrusters_active": is_active,
    }


def report_line(report: Report) -> Line:
    """Return what the spacecraft tells of a command."""
    line: Line = {
        "type": "report",
        "counter": report.counter,
        "state": report.fate.value,
        "told": rfc3339(report.reported_us),
        "received": rfc3339(report.received_us),
    }
    if report.executed_us is not None:
        line["executed_from"], line["executed_until"] = (rfc3339(epoch_us) for epoch_us in report.executed_us)
        line["impulse_n_m_s"] = dict(zip(_AXES, report.impulse_n_m_s, strict=True))
    return line


def _row_line(epoch_us: int, power_dbm: FloatArray) -> Line:
    levels = [None if math.isnan(level) else round(level, 5) for level in power_dbm.tolist()]
    return {"type": "row", "epoch": rfc3339(epoch_us), "power_dbm": levels}


def _await_schedule(plant: Plant, source: TextIO, sink: TextIO) -> Schedule | None:
    """Return the next schedule; None at the end of the input."""
    while text := source.readline(MAX_LINE_CHARACTERS + 1):
        try:
            if len(text) > MAX_LINE_CHARACTERS:
                _skip_line(text, source)
            return parse_schedule(text, plant.epoch_us)
        except ScheduleError as error:
            _send(sink, iter([{"type": "error", "detail": str(error)}]))
    return None


def _skip_line(text: str, source: TextIO) -> None:
    """Read the rest of a line that is too long."""
    while text and not text.endswith("\n"):
        text = source.readline(MAX_LINE_CHARACTERS)


def _send(sink: TextIO, lines: Iterator[Line]) -> None:
    for line in lines:
        sink.write(json.dumps(line, allow_nan=False, separators=(",", ":")) + "\n")
    sink.flush()
