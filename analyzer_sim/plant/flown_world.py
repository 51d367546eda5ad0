"""Flown world: the world behind a served instrument whose operation phase is flown by torques.

Up to the first row of operation it is the world as told; from there on each sweep flies the spacecraft to the row that
is swept, with what has come over the uplink until then, and shows the powers of the attitude flown.
"""

from collections.abc import Callable, Iterator
from typing import Any

from analyzer_sim.emission import Emission
from analyzer_sim.epochs import rfc3339
from analyzer_sim.plant.plant import Plant, PlantOptions
from analyzer_sim.plant.plant_lines import report_line, telemetry_of
from analyzer_sim.plant.schedule_lines import Schedule, ScheduleError, parse_schedule
from analyzer_sim.plant.world_changes import ChangeError, WorldChange, changed_emission, parse_change, response_factor
from analyzer_sim.world.ground.ground import truth_row
from analyzer_sim.world.scenario.story import Scenario
from analyzer_sim.world.world import World

Line = dict[str, Any]
#: hears what a spacecraft has told on the way to a row: the row's epoch and the lines
Listener = Callable[[int, list[Line]], None]

#: schedules that may be sent from one row: more than anybody needs, few enough to keep the store small
SCHEDULES_A_ROW = 100
_NOTHING = Schedule(())


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

    def __init__(self, scenario: Scenario, seed: int, options: PlantOptions) -> None:
        self.options = options
        # the instrument has noise of its own
        self._plant = Plant(scenario, seed, 0.0, options)
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
            raise ScheduleError(f"the spacecraft is under its sensors until {start} has been measured")
        schedule = parse_schedule(text, self.epoch_us)
        if self._sent_from_row >= SCHEDULES_A_ROW:
            raise ScheduleError(f"more than {SCHEDULES_A_ROW} schedules from one row")
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
            yield {"kind": "telemetry", "body": {"records": [telemetry_of(self._plant)]}}
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
            self._report([report_line(report) for report in self._plant.reports])
        if self._plant.row == self._plant.first_row:
            self._report([])
        self._sent_from_row = 0

    def _report(self, lines: list[Line]) -> None:
        for listener in self._listeners:
            listener(self._plant.epoch_us, lines)

    def _flown_emission(self, row: int) -> Emission:
        """Return what arrives at the attitude flown."""
        # power control remembers, so that its rows are computed from the first one on
        first = 0 if self.world.terms.has_control else row
        levels = self.world.terms.levels(self._attitude_deg[first : row + 1], first)
        return self.world.emission(row, levels.carrier_dbm[-1])
