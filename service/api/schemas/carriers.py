"""Documents of carrier plans, and the digest that makes the same content the same plan."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from hashlib import sha256
from typing import Annotated, Literal, Self

from pydantic import Field, TypeAdapter, model_validator
from pydantic_core import PydanticCustomError

from service.api.schemas.base import Answer, CatalogueWarning, Document, LatitudeDeg, LongitudeDeg, Name, Text
from service.records.catalogue import Carrier, CarrierPlan

MAX_CARRIERS = 512
#: fields of the document are those of the record
_CARRIER = TypeAdapter(Carrier)
FrequencyHz = Annotated[float, Field(gt=0, le=1e12)]


class StationDocument(Document):
    """Earth station that radiates a carrier."""

    name: Text = ""
    latitude_deg: LatitudeDeg
    longitude_deg: LongitudeDeg


class CarrierDocument(Document):
    """One signal of one earth station through one transponder."""

    id: Name
    name: Text = ""
    station: StationDocument | None = None
    """null only for a beacon."""
    band: Name
    transponder: Name
    polarization: Text | None = None
    uplink_hz: FrequencyHz | None = None
    """null only for a beacon."""
    downlink_hz: FrequencyHz
    intermediate_hz: FrequencyHz | None = None
    bandwidth_hz: FrequencyHz
    kind: Literal["traffic", "beacon", "pilot"] = "traffic"
    uplink_power_control: Literal["none", "auto", "unknown"] = "unknown"
    """A carrier with auto is never used for attitude: its station would compensate what is measured."""
    transponder_mode: Literal["fixed_gain", "alc", "unknown"] = "unknown"
    enabled: bool = True

    @model_validator(mode="after")
    def _check_uplink(self) -> Self:
        """Refuse a carrier without an uplink station."""
        if self.kind != "beacon" and self.station is None:
            raise PydanticCustomError("carrier.station_missing", "a carrier that is no beacon needs its station")
        if self.kind != "beacon" and self.uplink_hz is None:
            raise PydanticCustomError("carrier.uplink_missing", "a carrier that is no beacon needs its uplink_hz")
        return self

    def to_record(self) -> Carrier:
        """Return the record that this document states."""
        return _CARRIER.validate_python(self.model_dump())


def _check_ids(carriers: tuple[CarrierDocument, ...]) -> None:
    """Refuse a plan in which two carriers have one id."""
    seen: set[str] = set()
    for carrier in carriers:
        if carrier.id in seen:
            message = "two carriers have the id {id}; ids are unique within a plan"
            raise PydanticCustomError("carrier.duplicate", message, {"id": carrier.id})
        seen.add(carrier.id)


class CarrierPlanDocument(Document):
    """The carriers of a plan; their order is the order of the powers of a measurement."""

    carriers: Annotated[tuple[CarrierDocument, ...], Field(min_length=1, max_length=MAX_CARRIERS)]

    @model_validator(mode="after")
    def _check(self) -> Self:
        """Refuse repeated ids."""
        _check_ids(self.carriers)
        return self

    def to_records(self) -> tuple[Carrier, ...]:
        """Return the records that this document states."""
        return tuple(carrier.to_record() for carrier in self.carriers)


CARRIER_PLAN_ADAPTER = TypeAdapter(CarrierPlanDocument)


class PlanReceiptAnswer(Answer):
    """A stored plan."""

    plan_id: int
    sha256: str
    carriers: int
    warnings: list[CatalogueWarning]
    """Stations that have the satellite below 5 deg elevation."""


class CarrierPlanAnswer(Answer):
    """A plan with its carriers."""

    plan_id: int
    sha256: str
    carriers: list[CarrierDocument]

    @classmethod
    def of(cls, plan: CarrierPlan) -> Self:
        """Return the answer for a plan."""
        carriers = [CarrierDocument.model_validate(asdict(carrier), strict=False) for carrier in plan.carriers]
        return cls(plan_id=plan.id, sha256=plan.sha256, carriers=carriers)


def content_digest(carriers: Sequence[Carrier]) -> str:
    """Return the SHA-256 of a plan's canonical content: every field, sorted keys, no white space, UTF-8.

    Parameters
    ----------
    carriers : sequence of Carrier
        In the order of the plan; another order is another plan.
    """
    content = [asdict(carrier) for carrier in carriers]
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return sha256(text.encode()).hexdigest()
