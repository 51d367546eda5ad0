"""Versions of the carrier plan that the ground publishes in the course of a story."""

from dataclasses import dataclass

from analyzer_sim.epochs import US_PER_H
from analyzer_sim.world.payload.carriers import Carrier, CarrierPlan
from analyzer_sim.world.scenario.events import PlanChange
from analyzer_sim.world.scenario.story import Scenario


@dataclass(frozen=True, slots=True)
class PlanVersion:
    """The carriers of one published plan."""

    #: epoch from which it holds
    reported_us: int
    carriers: tuple[Carrier, ...]


def plan_versions(scenario: Scenario, plan: CarrierPlan) -> tuple[PlanVersion, ...]:
    """Return every version in order of time; the first holds from the start."""
    changes = sorted((f for f in scenario.faults if isinstance(f, PlanChange)), key=lambda change: change.start_h)
    on_air = {carrier.id for carrier in plan.carriers} - {name for change in changes for name in change.new}
    versions = [_version(scenario.start_us, plan, on_air)]
    for change in changes:
        on_air = (on_air - set(change.gone)) | set(change.new)
        version = _version(scenario.operation_start_us + round(change.start_h * US_PER_H), plan, on_air)
        ordered = version.carriers[::-1] if change.is_order_reversed else version.carriers
        versions.append(PlanVersion(version.reported_us, ordered))
    return tuple(versions)


def _version(reported_us: int, plan: CarrierPlan, on_air: set[str]) -> PlanVersion:
    return PlanVersion(reported_us, tuple(carrier for carrier in plan.carriers if carrier.id in on_air))
