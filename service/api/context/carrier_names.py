"""Ids of the carriers of a plan, kept in memory: plans are immutable, and every row sent out names its carriers."""

import threading

from service.ports import Catalogue


class CarrierNameCache:
    """Carrier ids of the plans asked for so far; safe from any thread.

    Parameters
    ----------
    catalogue : Catalogue
        Where plans are looked up once.
    """

    def __init__(self, catalogue: Catalogue) -> None:
        self._catalogue = catalogue
        self._lock = threading.Lock()
        self._names: dict[tuple[str, int], tuple[str, ...]] = {}

    def knows(self, spacecraft_id: str, plan_id: int) -> bool:
        """Return whether the carrier ids of a plan need no look-up."""
        with self._lock:
            return (spacecraft_id, plan_id) in self._names

    def of(self, spacecraft_id: str, plan_id: int) -> tuple[str, ...]:
        """Return the carrier ids in the order of a row's powers; NotFoundError ``plan.unknown``."""
        key = (spacecraft_id, plan_id)
        with self._lock:
            known = self._names.get(key)
        if known is None:
            known = self._catalogue.plan(spacecraft_id, plan_id).carrier_ids
            with self._lock:
                self._names[key] = known
        return known
