"""Plant: a world whose operation phase is flown by torques that come in, row by row, while powers go out.

Standard output, one JSON object a line, in this order:

    {"type":"start","scenario":..,"seed":..,"carriers":[ids],"open_rows":n,"closed_rows":m}
    {"type":"ground","line":{..}}                what the ground port would send, corrections left out
    {"type":"truth","epoch":..,"yaw_deg":..,..}  for the judge alone
    {"type":"row","epoch":..,"power_dbm":[..]}   null = absent; rows of a gap are left out
    {"type":"end"}

Quiet phase, turns and alignment run through without an answer. After each row of operation the plant waits for one line
`{"schedule":[{"start":..,"duration_s":..,"roll_n_m":..,"pitch_n_m":..,"yaw_n_m":..},..]}`; the elements join those
sent before and act on the body from their start, which is not before the row. A line that is not understood is
answered by `{"type":"error","detail":..}`, changes nothing, and another one is awaited. The end of standard input ends
the plant.
"""

import json
import math
from collections.abc import Iterator
from typing import Any, TextIO

import numpy as np

from analyzer_sim.epochs import US_PER_S, epoch_us_from_text, rfc3339
from analyzer_sim.export import measured_dbm, sweep_noise_db
from analyzer_sim.streams import FloatArray
from analyzer_sim.world.disturbance import disturbance
from analyzer_sim.world.ground import catalogue_lines, chunks_of, told_lines, truth_row
from analyzer_sim.world.ground_bodies import INERTIA_KG_M2, TORQUE_LIMIT_N_M
from analyzer_sim.world.orbit import EARTH_RATE_RAD_S
from analyzer_sim.world.rigid_body import BodyState, RigidBody, TorqueElement, Triple
from analyzer_sim.world.story import Scenario
from analyzer_sim.world.world import World

Line = dict[str, Any]

#: longest line, elements of one schedule, and duration of one element, s
MAX_LINE_CHARACTERS = 1_000_000
MAX_ELEMENTS = 10_000
MIN_DURATION_S, MAX_DURATION_S = 1e-6, 86_400.0
_FIELDS = {"start", "duration_s", "roll_n_m", "pitch_n_m", "yaw_n_m"}


class ScheduleError(ValueError):
    """A line holds no schedule that can be flown; the text says why."""


class Plant:
    """A world whose attitude is integrated from torques once operation has begun.

    Parameters
    ----------
    scenario : Scenario
        The story; its manoeuvres are not flown.
    seed : int
        Seed of every named stream.
    sweep_noise : float
        Scale of the stand-in for the sweep's own noise.

    Attributes
    ----------
    world : World
        Rows before operation are its rows, to the last bit.
    row : int
        Index of the present row.
    state : BodyState
        Attitude and rates at the present row.
    """

    def __init__(self, scenario: Scenario, seed: int, sweep_noise: float = 1.0) -> None:
        self.world = World(scenario, seed)
        self._epochs_us = self.world.rows.epochs_us
        self.first_row = int(np.searchsorted(self._epochs_us, scenario.operation_start_us))
        self.row = self.first_row
        self._noise_db = sweep_noise_db(self.world, sweep_noise)
        self.open_dbm = measured_dbm(self.world, sweep_noise)[: self.first_row]
        self._attitude_deg = self.world.rows.attitude_deg.copy()
        self._acting: list[TorqueElement] = []
        self._disturbance = disturbance(scenario, seed, self._epochs_us[self.first_row :])
        roll, pitch, yaw = INERTIA_KG_M2
        self._body = RigidBody((yaw, roll, pitch), EARTH_RATE_RAD_S if scenario.keeping.is_coupled else 0.0)
        self.state = BodyState(_triple(self._attitude_deg[self.first_row]), (0.0, 0.0, 0.0))

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
        """Whether the present row is measured at all."""
        return not self.world.rows.is_gap[self.row]

    def power_dbm(self) -> FloatArray:
        """Return the measured powers (N,) of the present row at the attitude flown, NaN = absent."""
        # power control remembers, so that its rows are computed from the first one on
        first = 0 if self.world.terms.has_control else self.row
        levels = self.world.terms.levels(self._attitude_deg[first : self.row + 1], first)
        power_dbm = self.world.terms.measurable_dbm(levels.carrier_dbm, first)
        return np.asarray(power_dbm[-1] + self._noise_db[self.row])

    def advance(self, schedule: list[TorqueElement]) -> bool:
        """Fly to the next row with these elements and those sent before; False after the last row."""
        if self.row + 1 >= self.row_count:
            return False
        begin_us, end_us = self.epoch_us, int(self._epochs_us[self.row + 1])
        self._acting = [element for element in [*self._acting, *schedule] if element.stop_us > begin_us]
        step = self.row - self.first_row
        drift_deg_s, torque_n_m = (_triple(series[step]) for series in self._disturbance)
        self.state = self._body.fly(self.state, (begin_us, end_us), self._acting, drift_deg_s, torque_n_m)
        self.row += 1
        self._attitude_deg[self.row] = self.state.attitude_deg
        return True


def parse_schedule(text: str, not_before_us: int) -> list[TorqueElement]:
    """Return the elements of a line.

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
    if not isinstance(message, dict) or set(message) != {"schedule"} or not isinstance(message["schedule"], list):
        raise ScheduleError('a line is {"schedule": [..]} and nothing else')
    if len(message["schedule"]) > MAX_ELEMENTS:
        raise ScheduleError(f"a schedule holds at most {MAX_ELEMENTS} elements")
    return [_element(k, item, not_before_us) for k, item in enumerate(message["schedule"])]


def _element(number: int, item: object, not_before_us: int) -> TorqueElement:
    if not isinstance(item, dict) or set(item) != _FIELDS:
        raise ScheduleError(f"element {number}: the fields are {', '.join(sorted(_FIELDS))}")
    duration_s = _number(number, item, "duration_s")
    if not MIN_DURATION_S <= duration_s <= MAX_DURATION_S:
        raise ScheduleError(f"element {number}: duration_s lies outside {MIN_DURATION_S:g}..{MAX_DURATION_S:g}")
    start_us = _start_us(number, item["start"])
    if start_us < not_before_us:
        raise ScheduleError(f"element {number}: it begins before the row of {rfc3339(not_before_us)}")
    yaw, roll, pitch = (_number(number, item, f"{axis}_n_m") for axis in ("yaw", "roll", "pitch"))
    if max(abs(yaw), abs(roll), abs(pitch)) > TORQUE_LIMIT_N_M:
        raise ScheduleError(f"element {number}: a torque exceeds {TORQUE_LIMIT_N_M:g} N m")
    return TorqueElement(start_us, start_us + round(duration_s * US_PER_S), (yaw, roll, pitch))


def _number(number: int, item: dict[str, object], name: str) -> float:
    value = item[name]
    if not isinstance(value, float) or not math.isfinite(value):
        raise ScheduleError(f"element {number}: {name} is not a finite number")
    return value


def _start_us(number: int, text: object) -> int:
    try:
        return epoch_us_from_text(str(text))
    except (ValueError, OverflowError):
        raise ScheduleError(f"element {number}: start is no RFC 3339 epoch with a zone") from None


def run_plant(scenario: Scenario, seed: int, sweep_noise: float, source: TextIO, sink: TextIO) -> int:
    """Play a story over a pair of text streams and return the exit status.

    Raises
    ------
    BrokenPipeError
        The reader has left.
    """
    plant = Plant(scenario, seed, sweep_noise)
    _send(sink, _opening(plant))
    while True:
        _send(sink, _present(plant))
        schedule = _await_schedule(plant, source, sink) if plant.is_measured else []
        if schedule is None:
            return 0
        if not plant.advance(schedule):
            _send(sink, iter([{"type": "end"}]))
            return 0


def _opening(plant: Plant) -> Iterator[Line]:
    """Yield everything before operation."""
    world = plant.world
    rows = {"open_rows": plant.first_row, "closed_rows": plant.row_count - plant.first_row}
    carriers = list(world.carrier_ids)
    yield {"type": "start", "scenario": world.scenario.name, "seed": world.seed, "carriers": carriers, **rows}
    yield from ({"type": "ground", "line": line} for line in catalogue_lines(world))
    for first, last, phase in chunks_of(world):
        if phase != "operation":
            yield from ({"type": "ground", "line": line} for line in told_lines(world, first, last))
            for row in range(first, last + 1):
                yield {"type": "truth", **truth_row(world, row, world.rows.attitude_deg[row])}
                yield _row_line(int(world.rows.epochs_us[row]), plant.open_dbm[row])


def _present(plant: Plant) -> Iterator[Line]:
    """Yield what belongs to the present row of operation."""
    for line in told_lines(plant.world, plant.row, plant.row):
        # the story's own corrections are not flown here
        if line["kind"] != "corrections":
            yield {"type": "ground", "line": line}
    rates = dict(zip(("yaw", "roll", "pitch"), plant.state.rate_deg_s, strict=True))
    truth = truth_row(plant.world, plant.row, plant.state.attitude_deg)
    yield {"type": "truth", **truth, "rates_deg_s": rates}
    if plant.is_measured:
        yield _row_line(plant.epoch_us, plant.power_dbm())


def _row_line(epoch_us: int, power_dbm: FloatArray) -> Line:
    levels = [None if math.isnan(level) else round(level, 5) for level in power_dbm.tolist()]
    return {"type": "row", "epoch": rfc3339(epoch_us), "power_dbm": levels}


def _await_schedule(plant: Plant, source: TextIO, sink: TextIO) -> list[TorqueElement] | None:
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


def _triple(values: FloatArray) -> Triple:
    first, second, third = (float(value) for value in values)
    return first, second, third
