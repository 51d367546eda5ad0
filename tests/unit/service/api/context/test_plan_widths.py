"""Widths of plans are asked for once."""

import pytest

from service.api.context.plan_widths import PlanWidths
from service.errors import NotFoundError
from service.records.catalogue import Carrier, CarrierPlan

pytestmark = pytest.mark.anyio


class CountingCatalogue:
    def __init__(self) -> None:
        self.asked: list[tuple[str, int]] = []

    def plan(self, spacecraft_id, plan_id):
        self.asked.append((spacecraft_id, plan_id))
        if spacecraft_id == "nobody":
            raise NotFoundError("spacecraft.unknown", "no such spacecraft")
        return CarrierPlan(plan_id, "", tuple(Carrier(f"c{k}", "Ku", "t", 1.0, 1.0) for k in range(plan_id)))


async def test_a_plan_is_looked_up_once():
    catalogue = CountingCatalogue()
    widths = PlanWidths(catalogue)
    assert [await widths.width("y", 3) for _ in range(5)] == [3] * 5
    assert catalogue.asked == [("y", 3)]


async def test_what_is_unknown_is_asked_for_again():
    catalogue = CountingCatalogue()
    widths = PlanWidths(catalogue)
    for _ in range(2):
        with pytest.raises(NotFoundError):
            await widths.width("nobody", 1)
    assert len(catalogue.asked) == 2, "the spacecraft may have been added meanwhile"


async def test_memory_is_bounded_and_keeps_what_is_in_use():
    catalogue = CountingCatalogue()
    widths = PlanWidths(catalogue, capacity=2)
    for spacecraft_id in ("a", "b", "a", "c", "a", "b"):
        await widths.width(spacecraft_id, 1)
    assert catalogue.asked == [("a", 1), ("b", 1), ("c", 1), ("b", 1)]
