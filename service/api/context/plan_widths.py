"""Number of carriers of each plan, kept in memory: plans are immutable, and every batch needs it."""

from collections import OrderedDict

from starlette.concurrency import run_in_threadpool

from service.errors import NotFoundError
from service.ports import Catalogue


class PlanWidths:
    """Widths of the plans asked for last.

    Parameters
    ----------
    catalogue : Catalogue
        Where plans are looked up once.
    capacity : int
        Plans kept; the one unused longest makes room.
    """

    def __init__(self, catalogue: Catalogue, capacity: int = 4096) -> None:
        self._catalogue = catalogue
        self._capacity = capacity
        self._widths: OrderedDict[tuple[str, int], int] = OrderedDict()

    async def width(self, spacecraft_id: str, plan_id: int) -> int:
        """Return the number of carriers; NotFoundError ``spacecraft.unknown`` or ``plan.unknown``."""
        key = (spacecraft_id, plan_id)
        known = self._widths.get(key)
        if known is not None:
            self._widths.move_to_end(key)
            return known
        plan = await run_in_threadpool(self._catalogue.plan, spacecraft_id, plan_id)
        if plan.is_withdrawn:
            raise NotFoundError("plan.unknown", f"Plan {plan_id} of {spacecraft_id!r} was withdrawn.")
        self._widths[key] = len(plan.carriers)
        if len(self._widths) > self._capacity:
            self._widths.popitem(last=False)
        return len(plan.carriers)

    def forget(self, spacecraft_id: str) -> None:
        """Forget the plans of a spacecraft: it was deleted, or one of them withdrawn."""
        for key in [key for key in self._widths if key[0] == spacecraft_id]:
            self._widths.pop(key, None)
