"""Scenarios: the stories of the catalogue by name, with another length, row period or start where one is wanted."""

from dataclasses import replace

from analyzer_sim.world.scenario.catalogue_hard import HARD, MOTION, WEATHER, WRONG
from analyzer_sim.world.scenario.catalogue_plain import (
    CLOSED,
    PLAIN,
    SOURCES_OF_REALITY,
    plant_varied,
)
from analyzer_sim.world.scenario.story import (
    Scenario,
)

#: every scenario by name
SCENARIOS: dict[str, Scenario] = {
    scenario.name: scenario for scenario in (*PLAIN, *HARD, *WRONG, *SOURCES_OF_REALITY, *WEATHER, *MOTION)
}
#: those that can be flown in closed loop: a few more
CLOSED_SCENARIOS: dict[str, Scenario] = {**SCENARIOS, **{scenario.name: scenario for scenario in CLOSED}}


def scenario_named(
    name: str,
    *,
    seed: int = 1,
    operation_days: float | None = None,
    quiet_days: float | None = None,
    row_period_s: float | None = None,
    start_us: int | None = None,
) -> Scenario:
    """Return a scenario of the catalogue, with another length, row period or start where one is given.

    The seed matters to `plant_varied` alone, which differs with it.

    Raises
    ------
    KeyError
        No scenario has this name; the message lists those that exist.
    """
    if name not in CLOSED_SCENARIOS:
        raise KeyError(f"no scenario {name!r}; there are {', '.join(sorted(CLOSED_SCENARIOS))}")
    chosen = plant_varied(seed) if name == "plant_varied" else CLOSED_SCENARIOS[name]
    return replace(
        chosen,
        operation_h=chosen.operation_h if operation_days is None else 24.0 * operation_days,
        quiet_h=chosen.quiet_h if quiet_days is None else 24.0 * quiet_days,
        row_period_s=chosen.row_period_s if row_period_s is None else row_period_s,
        start_us=chosen.start_us if start_us is None else start_us,
    )
