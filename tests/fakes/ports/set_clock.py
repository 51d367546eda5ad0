"""A clock that stands where a test puts it."""

from dataclasses import dataclass, field

from service.ports.storage import ClockReading
from service.records.catalogue import Spacecraft

#: 2026-11-21T03:00:00Z
NOW_US = 1_795_230_000_000_000


@dataclass
class SetClock:
    """A clock that stands still; spacecraft named in ``data`` live under the data clock."""

    system: int = NOW_US
    data: dict[str, int | None] = field(default_factory=dict)

    def reading(self, spacecraft: Spacecraft, newest_epoch_us: int | None) -> ClockReading:
        return ClockReading(self.is_data(spacecraft.id), self.data.get(spacecraft.id, self.system))

    def now_us(self, spacecraft_id: str) -> int | None:
        return self.data.get(spacecraft_id, self.system)

    def is_data(self, spacecraft_id: str) -> bool:
        return spacecraft_id in self.data

    def system_us(self) -> int:
        return self.system
