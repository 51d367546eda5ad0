"""The ports of people on shift: alarms and notes."""

from collections.abc import Iterator, Sequence
from typing import Protocol

from service.records.calibration import Window
from service.records.operations.alarm import Alarm, AlarmChange
from service.records.operations.alarm_limits import AlarmLimits
from service.records.operations.alarm_memory import EngineMemory
from service.records.operations.note import Note


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

    def alarms(
        self,
        spacecraft_id: str,
        states: Sequence[str],
        window: Window,
        limit: int,
        after: tuple[int, int] | None,
        *,
        newest_first: bool = False,
    ) -> list[Alarm]:
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

    def notes(
        self,
        window: Window,
        limit: int,
        after: tuple[int, int] | None,
        spacecraft_id: str | None = None,
        *,
        newest_first: bool = False,
    ) -> list[Note]:
        """Return notes about instants of a window in order of (epoch, id), also those about no spacecraft."""

    def drop_before(self, spacecraft_id: str | None, before_us: int) -> Iterator[int]:
        """Drop notes about a spacecraft, or about none (None), and instants before one.

        Yields how many, a transaction a step.
        """

    def newest(self, limit: int, spacecraft_id: str | None = None) -> list[Note]:
        """Return the notes with the greatest epochs, newest first."""

    def last_written(self, limit: int, spacecraft_id: str | None = None) -> list[Note]:
        """Return the notes that were stored last, newest first, whatever instant they are about."""
