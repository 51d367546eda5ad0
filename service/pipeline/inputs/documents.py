"""Documents of one spacecraft in memory, by the numbers that journal entries name."""

from dataclasses import dataclass, field

from service.records.calibration import Alignment, Calibration
from service.records.catalogue import Carrier, CarrierPlan, Ephemeris
from service.records.inputs import EphemerisChange, PlanChange


@dataclass
class JournalDocuments:
    """Documents that journal entries name by number."""

    plans: dict[int, CarrierPlan] = field(default_factory=dict)
    ephemerides: dict[int, Ephemeris] = field(default_factory=dict)
    calibrations: dict[int, Calibration] = field(default_factory=dict)
    alignments: dict[int, Alignment] = field(default_factory=dict)

    def plan(self, plan_id: int) -> CarrierPlan:
        """Return a carrier plan."""
        return self.plans[plan_id]

    def ephemeris(self, ephemeris_id: int) -> Ephemeris:
        """Return an ephemeris."""
        return self.ephemerides[ephemeris_id]

    def calibration(self, calibration_id: int) -> Calibration:
        """Return a calibration."""
        return self.calibrations[calibration_id]

    def alignment(self, alignment_id: int) -> Alignment:
        """Return an alignment."""
        return self.alignments[alignment_id]

    def add_plan(self, carriers: tuple[Carrier, ...]) -> PlanChange:
        """Keep a plan and return its journal entry."""
        number = len(self.plans) + 1
        self.plans[number] = CarrierPlan(number, "", carriers)
        return PlanChange(number)

    def add_ephemeris(self, ephemeris: Ephemeris) -> EphemerisChange:
        """Keep an ephemeris and return its journal entry."""
        number = len(self.ephemerides) + 1
        self.ephemerides[number] = ephemeris
        return EphemerisChange(number)
