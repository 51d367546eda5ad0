"""The simulator's plant in a thread of this process: a test may change the spacecraft while it is flown."""

import io
import os
from collections.abc import Callable
from threading import Thread
from types import SimpleNamespace

from analyzer_sim.plant.plant import Plant, PlantOptions, Schedule, run_plant
from analyzer_sim.world.scenario.story import Scenario
from service.study.closed_loop.plant_process import PlantProcess

#: deg; a spacecraft that is turned so far is lost, and its carriers with it
LOST_DEG = 20.0
#: called before each row with the plant and the hours of operation
Change = Callable[[Plant, float], None]


class _Flown(Plant):
    """A plant that is changed before each row; it ends where the spacecraft is lost."""

    change: Change

    def advance(self, schedule: Schedule) -> bool:
        self.change(self, (self.row - self.first_row) * self.world.scenario.row_period_s / 3600.0)
        return super().advance(schedule) and max(map(abs, self.state.attitude_deg)) < LOST_DEG


class ChangedPlant(PlantProcess):
    """A running plant of a story, its spacecraft changed under way."""

    def __init__(self, story: Scenario, seed: int, change: Change) -> None:
        plant = _Flown(story, seed, 1.0, PlantOptions("link"))
        plant.change = change
        (its_end, to_it), (from_it, its_start) = os.pipe(), os.pipe()
        self._process = SimpleNamespace(
            stdin=os.fdopen(to_it, "w"), stdout=os.fdopen(from_it), stderr=io.StringIO(), kill=self._end
        )

        def flown() -> None:
            with os.fdopen(its_end) as source, os.fdopen(its_start, "w") as sink:
                run_plant(plant, source, sink)

        self._thread = Thread(target=flown, daemon=True)
        self._process.communicate = lambda timeout: self._thread.join(timeout)
        self._thread.start()

    def _end(self) -> None:
        self._process.stdin.close()
        self._process.stdout.close()
