"""The ports of catalogue, keys, audit, releases, links, alarms, notes, leases and time; one database as a whole."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple, Protocol

from service.ports.archive import Archive, ListPart, Results
from service.records.catalogue import Carrier, CarrierPlan, Ephemeris, Spacecraft
from service.records.levels.measurement import KeptTrace, Ring, Trace, TraceHead, TraceReceipt, Whereabouts
from service.records.operations.access import (
    AccessKey,
    AuditEntry,
    AuditEvent,
    AuditFilter,
    AuditHead,
    BrowserSession,
    StoredKey,
)
from service.records.operations.alarms import Alarm, AlarmChange, AlarmLimits, EngineMemory, Note
from service.records.operations.release import Command, ProductForm, ReleaseChange, StoredRelease, UplinkProduct
from service.records.operations.work import LinkReport, LinkState
from service.records.storage import StorageState


class Keys(Protocol):
    """Access keys; only digests of them are ever stored."""

    def add(self, stored: StoredKey) -> AccessKey:
        """Store a new key; ConflictError ``key.exists`` when one in force has the name, whatever its case."""

    def all(self) -> tuple[StoredKey, ...]:
        """Return every key, revoked ones too, in order of creation."""

    def revoke(self, key_id: str, at_us: int) -> AccessKey:
        """Make a key worthless from now on; NotFoundError ``key.unknown`` also when it was revoked before."""

    def note_used(self, used_us: Mapping[str, int]) -> None:
        """Store when keys were last used, by id."""

    def add_first_administrator(self, stored: StoredKey, audit_event: AuditEvent) -> bool:
        """Store an administrator's key with its audit entry unless one is in force; return whether it was stored."""

    def service_id(self) -> str:
        """Return the id of the service that the archive belongs to."""

    def open_session(self, session: BrowserSession, at_us: int) -> None:
        """Store a session; those that have ended by then are forgotten."""

    def end_session(self, digest: bytes) -> None:
        """Forget a session."""

    def sessions(self) -> dict[bytes, BrowserSession]:
        """Return the sessions by their digests, some that have ended among them."""


class Audit(Protocol):
    """The audit log: entries are added, never changed."""

    def append(self, audit_event: AuditEvent) -> AuditEntry:
        """Add a deed and wait for its commit."""

    def entries(
        self, wanted: AuditFilter, limit: int, after: int | None, *, newest_first: bool = False
    ) -> list[AuditEntry]:
        """Return entries with numbers above ``after``, in order, or those below it in the reverse order."""

    def head(self) -> AuditHead:
        """Return the newest entry's number and hash as they stand beside the entries."""

    def chain(self) -> Iterator[AuditEntry]:
        """Yield every entry in order of number."""


class Catalogue(Protocol):
    """Spacecraft, carrier plans, ephemerides."""

    def add_spacecraft(self, spacecraft: Spacecraft) -> None:
        """Store and journal a new spacecraft; ConflictError ``spacecraft.exists``."""

    def replace_spacecraft(self, spacecraft: Spacecraft) -> None:
        """Store and journal a changed spacecraft under its id."""

    def spacecraft(self, spacecraft_id: str) -> Spacecraft:
        """Return one spacecraft."""

    def whereabouts(self, spacecraft_id: str) -> Whereabouts:
        """Return where everything of a spacecraft stands, by one statement; NotFoundError ``spacecraft.unknown``."""

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

    def damaged_documents(self, spacecraft_id: str) -> tuple[str, ...]:
        """Return the names of the documents in force that differ from their digests, for example ``calibration 3``."""


class ClockReading(NamedTuple):
    """Present of a spacecraft."""

    #: whether the epochs that it sends move its clock
    is_data: bool
    #: microseconds UTC; None before the first row under the data clock
    now_us: int | None


class Clock(Protocol):
    """The only source of time."""

    def reading(self, spacecraft: Spacecraft, newest_epoch_us: int | None) -> ClockReading:
        """Return the present of a spacecraft whose newest epoch is known; nothing is looked up."""

    def now_us(self, spacecraft_id: str) -> int | None:
        """Return the present of a spacecraft, microseconds UTC; None before its first row under the data clock."""

    def is_data(self, spacecraft_id: str) -> bool:
        """Return whether a spacecraft lives under the data clock, where its present is the newest epoch it sent."""

    def system_us(self) -> int:
        """Return the system's present, microseconds UTC, for receipt and creation times."""


#: lease of what belongs to no spacecraft: jobs, alarms of the service, checksums
ARCHIVE = ""
#: number of the leadership term of a spacecraft, or of the archive, in this process; 0 while another one leads it
Term = Callable[[str], int]


#: number of a process among those on a server, and its terms by name
LeaseLoan = tuple[int | None, Mapping[str, int]]


class Leases(Protocol):
    """Leases of an archive: one a spacecraft, and one of the archive.

    A lease ends with its holder, however that ends; one that does not answer for 15 s has lost it. A write under a
    lease that is another's is refused inside the transaction: StorageError ``lease.lost``.
    """

    def poll(self, *, is_estimator: bool) -> Term:
        """Renew the leases of this process, take its share of those that are free, give back what is above it.

        Waits for nobody. While the archive does not answer no term is held. Who is no estimator gets no lease.
        """

    def wait(self, limit_s: float) -> frozenset[str]:
        """Wait until other processes have announced changes, at most so long; return the ids of the spacecraft."""

    def leaders(self) -> dict[str, str]:
        """Return the name of the process that leads each spacecraft, and the archive, where the archive knows it."""

    def silent_s(self) -> float:
        """Return for how long no process has been seen to lead the archive, by the polls of this one."""

    def ended(self) -> int:
        """Return a number that changes when another process has ended; its jobs are nobody's then."""

    def lend(self) -> LeaseLoan | None:
        """Return what a process of ours needs to write under the leases of this one; None where it needs nothing."""

    def borrow(self, loan: LeaseLoan | None) -> None:
        """Write under the leases of another process from now on."""

    def give_back(self) -> None:
        """Let other processes have all leases."""


class Releases(Protocol):
    """State of the release, commands and uplink products of each spacecraft."""

    def stored(self, spacecraft_id: str) -> StoredRelease:
        """Return the newest state; version 0 and an empty document before the first."""

    def versions(self) -> dict[str, int]:
        """Return the version of the newest state of each spacecraft that has one."""

    def save(self, spacecraft_id: str, version: int, change: ReleaseChange) -> int:
        """Store a change and its journal entries in one transaction and return the version that it has.

        ConflictError ``release.changed``: the stored version is another than the one given, or a command or product
        of the same counter says something else; nothing is stored then.
        """

    def command(self, spacecraft_id: str, counter: int) -> Command:
        """Return one command; NotFoundError ``command.unknown``."""

    def commands(self, spacecraft_id: str, part: ListPart) -> list[Command]:
        """Return commands prepared in a window in order of (prepared, counter) beyond a cursor."""

    def product(self, spacecraft_id: str, form: ProductForm, counter: int) -> UplinkProduct:
        """Return one uplink product; NotFoundError ``uplink.unknown``."""

    def newest_product(self, spacecraft_id: str, form: ProductForm) -> UplinkProduct | None:
        """Return the product of a form with the greatest counter."""


class Links(Protocol):
    """Link states reported by front ends, and states requested by operators."""

    def report(self, reports: Sequence[LinkReport], at_us: int) -> tuple[LinkState, ...]:
        """Store the newest reports in one transaction and return the state of each link; a new link is enabled.

        ConflictError ``link.too_many``: a thousand links are known already.
        """

    def links(self, spacecraft_id: str | None = None) -> tuple[LinkState, ...]:
        """Return all links, or those of one spacecraft, in order of id."""

    def link(self, link_id: str) -> LinkState:
        """Return one link; NotFoundError ``link.unknown``."""

    def set_enabled(self, link_id: str, *, enabled: bool) -> LinkState:
        """Enable or disable a link until the next call."""

    def request_reset(self, link_id: str) -> LinkState:
        """Count one more reset that is wanted of a link."""

    def remove(self, link_id: str) -> None:
        """Forget a link; it comes back with its next report, enabled."""


class Traces(Protocol):
    """Evidence traces: a ring of sweeps a source."""

    def append(
        self, spacecraft_id: str, source: str, traces: Sequence[Trace], received_at_us: int, ring: Ring
    ) -> TraceReceipt:
        """Store traces of one source and drop, oldest epoch first, what its ring has no place for, as one.

        Same source, sweep and epoch: duplicate, the first one stays.
        """

    def heads(
        self, spacecraft_id: str, part: ListPart, source: str | None = None, sweep: str | None = None
    ) -> list[TraceHead]:
        """Return kept traces without their points in order of (epoch, number) beyond a cursor."""

    def trace(
        self, spacecraft_id: str, epoch_us: int, source: str | None = None, sweep: str | None = None
    ) -> KeptTrace:
        """Return the trace of an epoch; NotFoundError ``trace.unknown``, ConflictError ``trace.ambiguous``."""


class Alarms(Protocol):
    """Port of alarms: their history, their limits, and the memory of their conditions."""

    def save(self, changes: Sequence[AlarmChange]) -> tuple[AlarmChange, ...]:
        """Store changes in one transaction and return them with their numbers, alarms that are new with their ids.

        One process saves; numbers rise in the order of commits.
        """

    def alarm(self, alarm_id: int) -> Alarm:
        """Return one alarm; NotFoundError ``alarm.unknown``."""

    def open_alarms(self, spacecraft_id: str | None) -> tuple[Alarm, ...]:
        """Return the alarms of a spacecraft, or of the service (None), that stand, those under a cover too."""

    def alarms(self, spacecraft_id: str, states: Sequence[str], part: ListPart) -> list[Alarm]:
        """Return alarms of a spacecraft and of the service raised in a window, in order of (raised, id).

        Newest first: in the reverse order, where a cursor bounds from above; so it is in every list that has it. States
        are told ones; ``open`` stands for all that are not covered, ``closed`` for normal; none = all.
        """

    def changes(self, alarm_id: int) -> list[AlarmChange]:
        """Return the changes of one alarm, in order."""

    def changes_after(self, spacecraft_id: str, sequence: int, limit: int) -> list[AlarmChange]:
        """Return the changes of alarms of a spacecraft and of the service after a number, for a stream."""

    def newest_sequence(self) -> int:
        """Return the number of the newest change, 0 before the first."""

    def memory(self, spacecraft_id: str | None) -> EngineMemory:
        """Return the memory of the alarms of a spacecraft, or of the service."""

    def save_memory(self, spacecraft_id: str | None, memory: EngineMemory) -> None:
        """Store what they remember in place of what they did."""

    def count_refused(self, spacecraft_id: str, is_refused: Sequence[bool]) -> None:
        """Count records of telemetry that were refused one after another, whichever process refused them."""

    def refused(self) -> dict[str, int]:
        """Return how many records of telemetry were refused since one was accepted, by spacecraft; none: not named."""

    def limits(self, spacecraft_id: str, version: int | None = None) -> AlarmLimits:
        """Return a version of the limits, or the newest, 0 = the defaults; NotFoundError ``alarm_limits.unknown``."""

    def drop_before(self, spacecraft_id: str | None, before_us: int) -> Iterator[int]:
        """Drop closed alarms of a spacecraft, or of the service (None), raised before an instant, and their changes.

        Yields how many, a transaction a step; open ones stay.
        """

    def put_limits(self, spacecraft_id: str, limits: AlarmLimits) -> AlarmLimits:
        """Store limits as the next version and return it; the version that they state is ignored."""


class Notes(Protocol):
    """The shift log: notes are added, never changed; retention may drop old ones."""

    def add(self, note: Note) -> Note:
        """Store a note (its id is ignored) and return it with its id; NotFoundError ``note.unknown``."""

    def note(self, note_id: int) -> Note:
        """Return one note; NotFoundError ``note.unknown``."""

    def notes(self, part: ListPart, spacecraft_id: str | None = None) -> list[Note]:
        """Return notes about instants of a window in order of (epoch, id), also those about no spacecraft."""

    def drop_before(self, spacecraft_id: str | None, before_us: int) -> Iterator[int]:
        """Drop notes about a spacecraft, or about none (None), and instants before one.

        Yields how many, a transaction a step.
        """

    def last_written(self, limit: int, spacecraft_id: str | None = None) -> list[Note]:
        """Return the notes that were stored last, newest first, whatever instant they are about."""


class Storage(Protocol):
    """One database seen as a whole."""

    catalogue: Catalogue
    archive: Archive
    results: Results
    links: Links
    alarms: Alarms
    notes: Notes
    releases: Releases
    traces: Traces
    keys: Keys
    audit: Audit
    leases: Leases

    def prepare(self) -> None:
        """Make the tables of an archive in an empty database; ValueError for an archive of another layout."""

    def require_layout(self) -> None:
        """Raise ValueError unless this is an archive of the layout of this program."""

    def state(self) -> StorageState:
        """Return the state of the storage; StorageError unless the database answers."""

    def close(self) -> None:
        """Commit what is queued and let go of the database."""
