"""The port of what stands: spacecraft, carrier plans, ephemerides."""

from collections.abc import Sequence
from typing import Protocol

from service.records.catalogue import Carrier, CarrierPlan, Ephemeris, Spacecraft


class Catalogue(Protocol):
    """Spacecraft, carrier plans, ephemerides."""

    def add_spacecraft(self, spacecraft: Spacecraft) -> None:
        """Store and journal a new spacecraft; ConflictError ``spacecraft.exists``."""

    def replace_spacecraft(self, spacecraft: Spacecraft) -> None:
        """Store and journal a changed spacecraft under its id."""

    def spacecraft(self, spacecraft_id: str) -> Spacecraft:
        """Return one spacecraft."""

    def all_spacecraft(self) -> tuple[Spacecraft, ...]:
        """Return all spacecraft in order of id."""

    def delete_spacecraft(self, spacecraft_id: str) -> None:
        """Delete a spacecraft without rows; ConflictError ``spacecraft.has_rows``. Its id is not given again."""

    def withdraw_plan(self, spacecraft_id: str, plan_id: int) -> None:
        """Withdraw a plan that nothing rests on, journaled; it can be read by its number, which is not given again.

        NotFoundError ``plan.unknown``; ConflictError ``plan.in_use``.
        """

    def put_plan(self, spacecraft_id: str, carriers: Sequence[Carrier], sha256: str) -> CarrierPlan:
        """Return the plan with this content, storing and journaling it when it is new or no longer the newest."""

    def plan(self, spacecraft_id: str, plan_id: int | None = None) -> CarrierPlan:
        """Return one plan, or the one put last; NotFoundError ``plan.unknown`` or ``plan.none``."""

    def put_ephemeris(self, spacecraft_id: str, ephemeris: Ephemeris) -> Ephemeris:
        """Store and journal an ephemeris (its id is ignored) and return it with its id."""

    def ephemeris(self, spacecraft_id: str, ephemeris_id: int | None = None) -> Ephemeris:
        """Return one ephemeris, or the newest; NotFoundError ``ephemeris.unknown`` or ``ephemeris.none``."""
