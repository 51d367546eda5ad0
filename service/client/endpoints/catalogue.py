"""Catalogue: spacecraft, carrier plans, ephemerides."""

from collections.abc import Mapping
from typing import Any

from service.client.call import Call
from service.client.documents import Json, PlanPut
from service.client.endpoint_methods import endpoint
from service.client.endpoints.paths import Rows, below


class CatalogueEndpoints:
    """Methods of the catalogue."""

    @endpoint
    def create_spacecraft(self, spacecraft: Mapping[str, Any]) -> Call[Json]:
        """Add a spacecraft."""
        return Call("POST", "/spacecraft", spacecraft)

    @endpoint
    def spacecraft(self, spacecraft_id: str) -> Call[Json]:
        """Return one spacecraft."""
        return Call("GET", below(spacecraft_id))

    @endpoint
    def put_carriers(self, spacecraft_id: str, carriers: Rows) -> Call[PlanPut]:
        """Store a carrier plan; the same content gives the same plan_id."""
        return Call("PUT", below(spacecraft_id, "/carriers"), {"carriers": list(carriers)})

    @endpoint
    def carriers(self, spacecraft_id: str, plan_id: int | None = None) -> Call[Json]:
        """Return the newest carrier plan, or the one with this number."""
        return Call("GET", below(spacecraft_id, "/carriers"), params={"plan_id": plan_id})

    @endpoint
    def put_ephemeris(self, spacecraft_id: str, ephemeris: Mapping[str, Any]) -> Call[Json]:
        """Store an ephemeris: nodes and period, TLE, or OEM."""
        return Call("PUT", below(spacecraft_id, "/ephemeris"), ephemeris)
