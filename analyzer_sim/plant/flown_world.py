"""World that the plant flies, and changes of it on order."""

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from enum import StrEnum
from typing import Any, NamedTuple

from analyzer_sim.emission import Emission, Signal
from analyzer_sim.epochs import US_PER_S, rfc3339
from analyzer_sim.plant import plant
from analyzer_sim.world.ground.ground import truth_row
from analyzer_sim.world.scenario.story import Scenario
from analyzer_sim.world.world import World

#: attenuation of all carriers by rain over the receiving site, rise of the noise density, and step of one carrier, dB
RAIN_DB, RAIN_NOISE_DB, STEP_DB = 6.0, 2.0, 3.0
MAX_DURATION_S = 86_400.0
MAX_LINE_BYTES = 4096


class ChangeError(ValueError):
    """A line holds no change that can be made; the text gives the reason."""


class ChangeKind(StrEnum):
    """Kinds of changes."""

    RAIN = "rain"
    STEP = "step"
    DEAD_CARRIER = "dead-carrier"
    SIGN = "sign"


#: those that concern one carrier
_OF_CARRIER = (ChangeKind.STEP, ChangeKind.DEAD_CARRIER)


class WorldChange(NamedTuple):
    """A change from one instant, exclusive, to another, inclusive, microseconds UTC."""

    kind: ChangeKind
    start_us: int
    stop_us: int
    #: empty = it concerns no single carrier
    carrier: str = ""

    def is_active(self, epoch_us: int) -> bool:
        """Tell whether it acts at an epoch."""
        return self.start_us < epoch_us <= self.stop_us


def parse_change(text: str, epoch_us: int, carriers: Sequence[str]) -> WorldChange:
    """Return the change of a line that begins after an epoch.

    Raises
    ------
    ChangeError
        Not JSON, an unknown kind or carrier, no duration or one beyond a day.
    """
    try:
        message = json.loads(text, parse_int=float)
        kind, duration_s = ChangeKind(message["change"]), message["duration_s"]
        carrier = message.get("carrier", carriers[0] if kind in _OF_CARRIER else "")
    except (ValueError, RecursionError, TypeError, KeyError, AttributeError):
        known = ", ".join(ChangeKind)
        raise ChangeError(f'a line is {{"change":KIND,"duration_s":..,["carrier":..]}}, KIND of {known}') from None
    if not isinstance(duration_s, float) or not 0.0 < duration_s <= MAX_DURATION_S:
        raise ChangeError(f"duration_s lies outside 0..{MAX_DURATION_S:g}")
    if kind in _OF_CARRIER and carrier not in carriers:
        raise ChangeError(f"there is no carrier {str(carrier)[:40]!r}; the carriers are {', '.join(carriers)}")
    if kind not in _OF_CARRIER and carrier:
        raise ChangeError(f"{kind} concerns no single carrier: leave the carrier out")
    return WorldChange(kind, epoch_us, epoch_us + round(duration_s * US_PER_S), carrier)


def changed_emission(emission: Emission, changes: Iterable[WorldChange]) -> Emission:
    """Return an emission with the changes that act at its epoch; the reversed wheels change nothing that arrives."""
    for change in changes:
        if not change.is_active(emission.epoch_us):
            continue
        if change.kind is ChangeKind.RAIN:
            signals = tuple(_shifted(signal, -RAIN_DB) for signal in emission.signals)
            emission = replace(emission, signals=signals, noise_dbm_hz=emission.noise_dbm_hz + RAIN_NOISE_DB)
        elif change.kind is ChangeKind.STEP:
            signals = tuple(
                _shifted(signal, STEP_DB) if signal.carrier == change.carrier else signal for signal in emission.signals
            )
            emission = replace(emission, signals=signals)
        elif change.kind is ChangeKind.DEAD_CARRIER:
            signals = tuple(signal for signal in emission.signals if signal.carrier != change.carrier)
            emission = replace(emission, signals=signals)
    return emission


def response_factor(changes: Iterable[WorldChange], epoch_us: int) -> float:
    """Return what a commanded torque does on the way to an epoch: 1 = what it says, -1 = the opposite."""
    is_reversed = any(change.kind is ChangeKind.SIGN and change.is_active(epoch_us) for change in changes)
    return -1.0 if is_reversed else 1.0


def _shifted(signal: Signal, change_db: float) -> Signal:
    return replace(signal, power_dbm=signal.power_dbm + change_db)


Line = dict[str, Any]
#: hears what a spacecraft has told on the way to a row: the row's epoch and the lines
Listener = Callable[[int, list[Line]], None]

#: schedules that may be sent from one row: more than anybody needs, few enough to keep the store small
SCHEDULES_A_ROW = 100
_NOTHING = plant.Schedule(())


class FlownWorld:
    """A world whose craft answers torque schedules; implements `EmissionSource`.

    Parameters
    ----------
    scenario : Scenario
        The story; its manoeuvres are not flown.
    seed : int
        Seed of every named stream.
    options : PlantOptions
        OrbitalFrameSpacecraft and channel.

    Attributes
    ----------
    world : World
        The story; before operation its rows are what is swept.
    options : PlantOptions
        OrbitalFrameSpacecraft and channel.
    """

    def __init__(self, scenario: Scenario, seed: int, options: plant.PlantOptions) -> None:
        self.options = options
        # the instrument has noise of its own
        self._plant = plant.Plant(scenario, seed, 0.0, options)
        self.world: World = self._plant.world
        self._attitude_deg = self.world.rows.attitude_deg.copy()
        self._attitude_deg[self._plant.row] = self._plant.state.attitude_deg
        self._sent_from_row = 0
        self._listeners: list[Listener] = []
        self._emission: Emission | None = None
        self._changes: list[WorldChange] = []

    @property
    def epoch_us(self) -> int | None:
        """Epoch to which the spacecraft has been flown; None before operation."""
        return self._plant.epoch_us if self._is_flown(self.world.row_index) else None

    def listen(self, listener: Listener) -> None:
        """Let somebody hear what the spacecraft tells with each row."""
        self._listeners.append(listener)

    def advance(self) -> Emission:
        """Move to the next row that is measured and return what arrives there.

        Raises
        ------
        EndOfScenario
            There is no further row.
        """
        self._emission = self.world.advance()
        if self._is_flown(self.world.row_index):
            self._fly_to(self.world.row_index)
            self._emission = changed_emission(self._flown_emission(self.world.row_index), self._changes)
        return self._emission

    def current(self) -> Emission:
        """Return what arrives at the present instant."""
        return self._emission or self.world.current()

    def send(self, text: str) -> int | None:
        """Hand a line with a schedule to the uplink at the present row; return its counter, None = nothing to send.

        Raises
        ------
        ScheduleError
            The line holds no schedule that can be flown, or nothing is flown yet, or too many came from this row.
        """
        if self.epoch_us is None:
            start = rfc3339(self.world.scenario.operation_start_us)
            raise plant.ScheduleError(f"the spacecraft is under its sensors until {start} has been measured")
        schedule = plant.parse_schedule(text, self.epoch_us)
        if self._sent_from_row >= SCHEDULES_A_ROW:
            raise plant.ScheduleError(f"more than {SCHEDULES_A_ROW} schedules from one row")
        self._sent_from_row += 1
        return self._plant.send(schedule)

    def change(self, text: str) -> WorldChange:
        """Change the world as a line of the change port says, from the row after the present one; return the change.

        Raises
        ------
        ChangeError
            The line holds no change, or nothing is flown yet.
        """
        if self.epoch_us is None:
            raise ChangeError("nothing can be changed before the operation has begun; wait until it has")
        change = parse_change(text, self.epoch_us, self.world.carrier_ids)
        self._changes = [*(kept for kept in self._changes if kept.stop_us > self.epoch_us), change]
        return change

    def reported_after(self, first: int, last: int) -> Iterator[Line]:
        """Yield what the ground is told once rows of operation have been flown: telemetry, and truth for the judge."""
        start_us, stop_us = (int(self.world.rows.epochs_us[row]) for row in (first, last))
        if any(start_us <= record.reported_us <= stop_us for record in self.world.telemetry):
            yield {"kind": "telemetry", "body": {"records": [plant.telemetry_of(self._plant)]}}
        rows = [truth_row(self.world, row, self._attitude_deg[row]) for row in range(first, last + 1)]
        yield {"kind": "truth", "rows": rows}

    def _is_flown(self, row: int) -> bool:
        return row >= self._plant.first_row

    def _fly_to(self, row: int) -> None:
        """Fly the spacecraft to a row, over gaps too."""
        while self._plant.row < row:
            factor = response_factor(self._changes, int(self.world.rows.epochs_us[self._plant.row + 1]))
            roll, pitch, yaw = self.options.response
            self._plant.flown.response = (factor * roll, factor * pitch, factor * yaw)
            self._plant.advance(_NOTHING)
            self._attitude_deg[self._plant.row] = self._plant.state.attitude_deg
            self._report([plant.report_line(report) for report in self._plant.reports])
        if self._plant.row == self._plant.first_row:
            self._report([])
        self._sent_from_row = 0

    def _report(self, lines: list[Line]) -> None:
        for listener in self._listeners:
            listener(self._plant.epoch_us, lines)

    def _flown_emission(self, row: int) -> Emission:
        # power control remembers, so that its rows are computed from the first one on
        first = 0 if self.world.terms.has_control else row
        levels = self.world.terms.levels(self._attitude_deg[first : row + 1], first)
        return self.world.emission(row, levels.carrier_dbm[-1])
