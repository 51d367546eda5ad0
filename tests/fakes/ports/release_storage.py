"""What the release service asks of an archive, in memory; a process that is killed leaves behind what was stored."""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace

from service.errors import ConflictError, NotFoundError, StorageError
from service.records.calibration import CalibrationMethod
from service.records.catalogue import Onboard, Site, Spacecraft
from service.records.inputs import EphemerisChange, JournalEntry, Operation, TelemetryRecord
from service.records.levels.attitude import ReleasedCommand
from service.records.operations.release import ReleaseChange, StoredRelease

SC = "craft"
#: x roll, y pitch, z yaw
INERTIA = ((2600.0, 0.0, 0.0), (0.0, 1400.0, 0.0), (0.0, 0.0, 2600.0))
CRAFT = Spacecraft(SC, SC, 90.0, Site(55.0, 38.0), INERTIA, 0.05, onboard=Onboard(fast_loop=True, forecast_mode=True))


class KilledError(BaseException):
    """The process was killed: no code of the service goes on."""


@dataclass
class FakeReleases:
    """`Releases` of one spacecraft; can be away, and can be where a process is killed."""

    stored_release: StoredRelease = field(default_factory=StoredRelease)
    views: dict = field(default_factory=dict)
    products: dict = field(default_factory=dict)
    #: what entered the journal
    reported: list = field(default_factory=list)
    saves: int = 0
    is_away: bool = False
    #: whether the answer of the next change that is stored is lost
    is_answer_lost: bool = False
    #: "before" or "after" the next change is stored
    kill: str | None = None

    def stored(self, spacecraft_id):
        return self.stored_release

    def save(self, spacecraft_id: str, version: int, change: ReleaseChange) -> int:
        if self.is_away:
            raise StorageError("storage.unavailable", "away")
        kill, self.kill = self.kill, None
        if kill == "before":
            raise KilledError
        if version != self.stored_release.version:
            raise ConflictError("release.changed", "another version")
        for command in change.commands:
            former = self.views.get(command.counter)
            assert former is None or former.digest == command.digest, "a command became another one"
            self.views[command.counter] = command
        for product in change.products:
            key = product.form, product.counter
            assert key not in self.products, "an uplink product was made twice"
            self.products[key] = product
        self.reported += change.entries
        self.stored_release = StoredRelease(version + 1, change.document, change.holder)
        self.saves += 1
        if kill == "after":
            raise KilledError
        if self.is_answer_lost:
            self.is_answer_lost = False
            raise StorageError("storage.unavailable", "no answer")
        return version + 1

    def command(self, spacecraft_id, counter):
        if counter not in self.views:
            raise NotFoundError("command.unknown", "no such command")
        return self.views[counter]

    def commands(self, spacecraft_id, part):
        start_us, stop_us = part.window
        found = [each for each in self.views.values() if start_us <= each.prepared_us < stop_us]
        return sorted(found, key=lambda each: (each.prepared_us, each.counter), reverse=part.newest_first)[: part.limit]

    def product(self, spacecraft_id, form, counter):
        if (form, counter) not in self.products:
            raise NotFoundError("uplink.unknown", "no such product")
        return self.products[form, counter]

    def newest_product(self, spacecraft_id, form):
        counters = [counter for of, counter in self.products if of is form]
        return self.products[form, max(counters)] if counters else None

    @property
    def released(self):
        return [entry for entry in self.reported if isinstance(entry, ReleasedCommand)]


class FakeArchive:
    """The storage of one spacecraft as the service sees it; facts are changed by assignment."""

    def __init__(self, start_us: int) -> None:
        self.record = CRAFT
        self.is_aligned = True
        self.damaged_documents: tuple[str, ...] = ()
        self.plan_id, self.calibration_id = 3, 7
        self.ephemeris_received_us = start_us - 3_600_000_000
        self.ephemeris_stop_us = start_us + 90 * 86_400_000_000
        self.operations: list[Operation] = []
        self.telemetry: list[TelemetryRecord] = []
        self.audit_events: list = []
        self.releases = FakeReleases()
        self.catalogue = SimpleNamespace(
            spacecraft=self._spacecraft,
            all_spacecraft=lambda: (self.record,),
            plan=lambda _: SimpleNamespace(id=self.plan_id),
            ephemeris=lambda _: SimpleNamespace(valid_stop_us=self.ephemeris_stop_us),
            damaged_documents=lambda _: self.damaged_documents,
        )
        # what was computed before a start does not move this archive's clock
        head = SimpleNamespace(consumed_epoch_us=None)
        self.archive = SimpleNamespace(inputs=self._inputs, slow_inputs_before=self._ephemerides, head=lambda _: head)
        self.results = SimpleNamespace(
            alignments=lambda _: (1,) if self.is_aligned else (),
            calibrations=lambda *_: (self._calibration(),),
        )
        self.audit = SimpleNamespace(append=self.audit_events.append)
        self.leases = SimpleNamespace(leaders=lambda: {CRAFT.id: "host-1:7"})

    def change_spacecraft(self, **changes: object) -> None:
        """Change the catalogue's statement; fields of ``control`` by their own names."""
        own = {name: value for name, value in changes.items() if hasattr(self.record.control, name)}
        rest = {name: value for name, value in changes.items() if name not in own}
        self.record = replace(self.record, control=replace(self.record.control, **own), **rest)

    def _spacecraft(self, spacecraft_id):
        if spacecraft_id != SC:
            raise NotFoundError("spacecraft.unknown", spacecraft_id)
        return self.record

    def _calibration(self):
        return SimpleNamespace(id=self.calibration_id, request=SimpleNamespace(method=CalibrationMethod.GEOMETRY))

    def _inputs(self, spacecraft_id, kind, part, *, is_compared=False):
        window = part.window
        records = self.operations if kind == "operation" else self.telemetry
        reported = [each for each in records if getattr(each, "epoch_us", window.stop_us) >= window.start_us]
        if part.newest_first:
            reported = [each for each in reversed(reported) if each.epoch_us < window.stop_us]
        return [JournalEntry(k, each) for k, each in enumerate(reported, start=1)]

    def _ephemerides(self, *_):
        return [JournalEntry(1, EphemerisChange(1), self.ephemeris_received_us)]
