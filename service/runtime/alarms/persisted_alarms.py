"""The alarms of one spacecraft, or of the service, with what keeps them beyond a restart."""

from collections.abc import Mapping, Sequence

from service.pipeline.alarms.alarm_engine import AlarmEngine
from service.pipeline.alarms.readings import RowReader
from service.pipeline.alarms.states import AlarmCondition
from service.ports import Alarms
from service.records.epoch import US_PER_S
from service.records.operations.alarms import AlarmChange, AlarmLimits, EngineMemory

#: what is kept of the rows may be so old, us, and their period so far off
_FAR_US = 600 * US_PER_S
_OTHER_PACE = 0.2


class PersistedAlarms:
    """A book, its reader of rows, and the changes that wait to be stored.

    Parameters
    ----------
    alarms : Alarms
        Where they are kept; what is open is read from there.
    spacecraft_id : str or None
        None: the service as a whole.
    conditions : mapping
        Table of conditions.
    """

    def __init__(self, alarms: Alarms, spacecraft_id: str | None, conditions: Mapping[str, AlarmCondition]) -> None:
        self._alarms = alarms
        self._spacecraft_id = spacecraft_id
        self._unsaved: list[AlarmChange] = []
        self._kept = alarms.memory(spacecraft_id)
        limits = AlarmLimits() if spacecraft_id is None else alarms.limits(spacecraft_id)
        self.engine = AlarmEngine(spacecraft_id, conditions, limits, alarms.open_alarms(spacecraft_id), self._kept)
        self.reader = RowReader(self.engine, self._kept)
        self.reader.use_nominal(limits.nominal_dbm)

    def use_limits(self, limits: AlarmLimits, at_us: int) -> tuple[AlarmChange, ...]:
        """Hold values against other limits from now on; return what that changes, stored."""
        self.engine.use_limits(limits)
        self.reader.use_nominal(limits.nominal_dbm)
        return self.store(self.engine.enter(self.engine.context, at_us))

    def store(self, changes: Sequence[AlarmChange]) -> tuple[AlarmChange, ...]:
        """Store changes, and those that could not be stored before; return them with their numbers.

        Raises
        ------
        StorageError
            Nothing was stored; the next call tries again.
        """
        self._unsaved += changes
        if not self._unsaved:
            return ()
        saved = self._alarms.save(self._unsaved)
        self._unsaved.clear()
        for change in saved:
            self.engine.adopt(change.alarm)
        return saved

    def keep_memory(self) -> None:
        """Store what is about to happen, where it has changed."""
        memory = EngineMemory(self.engine.watches(), self.reader.newest_row_us, self.reader.row_period_s)
        # rows alone are no reason to write, nor is the jitter of their period
        if memory.watches != self._kept.watches or _is_other(memory, self._kept):
            self._alarms.save_memory(self._spacecraft_id, memory)
            self._kept = memory


def _is_other(memory: EngineMemory, kept: EngineMemory) -> bool:
    """Return whether rows have gone on by much, or come at another pace, since the memory was stored."""
    if memory.newest_row_us is None or memory.newest_row_us == kept.newest_row_us:
        return False
    if kept.newest_row_us is None or memory.newest_row_us - kept.newest_row_us > _FAR_US:
        return True
    before_s, now_s = kept.row_period_s or 0.0, memory.row_period_s or 0.0
    return abs(now_s - before_s) > _OTHER_PACE * before_s
