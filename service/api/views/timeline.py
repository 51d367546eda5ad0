"""Timeline of a span from what the archive stores: runs of states, inputs, commands, alarms and notes."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, get_args

from service.api.context import ApiContext
from service.api.protocol.paging import EVERYTHING
from service.api.schemas import archive as documents
from service.api.schemas.base import WindowAnswer
from service.api.schemas.inputs import CorrectionAnswer, OperationAnswer
from service.api.schemas.shift import AlarmAnswer, NoteAnswer
from service.core.rows import History, StateRun, coarsened
from service.ports.archive import ListPart
from service.records.calibration import Window
from service.records.catalogue import Method
from service.records.epoch import US_PER_S
from service.records.operations.alarms import Alarm
from service.records.operations.release import Command

#: runs of one method in an answer; with more, near ones are joined
MOST_RUNS = 1500
#: of each other list
MOST = 1000
_DAY_US = 86_400 * US_PER_S


@dataclass(frozen=True, slots=True)
class Timeline:
    """Span of one spacecraft, seen through the storage."""

    context: ApiContext
    spacecraft_id: str
    window: Window

    def answer(self, methods: Sequence[Method]) -> documents.TimelineAnswer:
        """Return all intervals and marks of the span."""
        results, expected = self.context.storage.results, self._expected()
        histories = [
            History([], [], []) if expected is None else results.state_history(self.spacecraft_id, each, expected)
            for each in methods
        ]
        coarse = [coarsened(history.runs, MOST_RUNS) for history in histories]
        runs = (_runs(method, found) for method, (_, found) in zip(methods, coarse, strict=True))
        lists = {name: self._list(name) for name in get_args(documents.Cut)}
        alignments = reversed(results.alignments(self.spacecraft_id))
        return documents.TimelineAnswer(
            range=WindowAnswer.of(self.window),
            joined_s=max(join_s for join_s, _ in coarse),
            states=[run for of_method in runs for run in of_method],
            gaps=[documents.GapAnswer.of(gap) for gap in histories[0].gaps],
            states_left_out=[WindowAnswer.of(Window(*ends)) for ends in sorted(_left_out(histories))],
            alignments=[
                documents.TimelineAlignmentAnswer.of(each) for each in alignments if self._holds(each.epoch_us)
            ],
            cut=[name for name, found in lists.items() if len(found) > MOST],
            **{name: found[:MOST] for name, found in lists.items()},
        )

    def _expected(self) -> Window | None:
        """Return the part of the span in which rows may be: from the first row of all until now, or the newest."""
        archive = self.context.storage.archive
        first = archive.measurements(self.spacecraft_id, ListPart(EVERYTHING, 1))
        if not first:
            return None
        newest_us = [each.newest_epoch_us for each in archive.sources(self.spacecraft_id)]
        now_us = self.context.clock.now_us(self.spacecraft_id)
        latest_us = max(each for each in (now_us, *newest_us) if each is not None)
        start_us, stop_us = max(self.window.start_us, first[0].epoch_us), min(self.window.stop_us, latest_us + 1)
        return Window(start_us, stop_us) if start_us < stop_us else None

    def _list(self, name: documents.Cut) -> list[Any]:
        """Return one list of the answer, one more than it may have tells that there are more."""
        read: dict[documents.Cut, Callable[[], Iterator[Any]]] = {
            "operations": lambda: self._inputs("operation", OperationAnswer.of),
            "corrections": lambda: self._inputs("correction", CorrectionAnswer.of),
            "commands": self._commands,
            "calibrations": self._activations,
            "alarms": self._alarms,
            "notes": self._notes,
        }
        return list(read[name]())

    def _inputs(self, kind: str, answer_of: Callable[[Any], Any]) -> Iterator[Any]:
        entries = self.context.storage.archive.inputs(self.spacecraft_id, kind, ListPart(self.window, MOST + 1))
        return (answer_of(entry.content) for entry in entries)

    def _activations(self) -> Iterator[documents.ActivationAnswer]:
        """Yield activations; when they were is the newest row of that moment."""
        storage = self.context.storage
        methods = {each.id: each.request.method.value for each in storage.results.calibrations(self.spacecraft_id)}
        for entry in storage.archive.inputs(self.spacecraft_id, "activation", ListPart(self.window, MOST + 1)):
            activated: Any = entry.content
            method = methods.get(activated.calibration_id, "")
            yield documents.ActivationAnswer.model_validate(
                {"calibration_id": activated.calibration_id, "method": method, "at": entry.start_us}
            )

    def _commands(self) -> Iterator[documents.TimelineCommandAnswer]:
        window = Window(self.window.start_us - _DAY_US, self.window.stop_us)
        for command in self.context.storage.releases.commands(self.spacecraft_id, ListPart(window, MOST + 1)):
            if self._reaches(command):
                yield documents.TimelineCommandAnswer.of(command, id=command.counter)

    def _alarms(self) -> Iterator[AlarmAnswer]:
        """Yield the alarms that were active within the span and follow from no other, in order of their raising."""
        alarms, start_us = self.context.storage.alarms, self.window.start_us
        before = Window(EVERYTHING.start_us, start_us)
        # of those closed since, the newest: what was raised before so many others is not looked for
        earlier = {
            each.id: each for each in alarms.alarms(self.spacecraft_id, (), ListPart(before, MOST, newest_first=True))
        }
        for about in (self.spacecraft_id, None):
            earlier |= {each.id: each for each in alarms.open_alarms(about) if each.raised_at_us < start_us}
        lasting = [each for each in earlier.values() if each.ended_us is None or each.ended_us >= start_us]
        lasting.sort(key=lambda each: (each.raised_at_us, each.id))
        raised: list[Alarm] = alarms.alarms(self.spacecraft_id, (), ListPart(self.window, MOST + 1))
        return (AlarmAnswer.of(each) for each in (*lasting, *raised) if each.cause is None)

    def _notes(self) -> Iterator[NoteAnswer]:
        found = self.context.storage.notes.notes(ListPart(self.window, MOST + 1), self.spacecraft_id)
        return (NoteAnswer.of(each) for each in found)

    def _holds(self, epoch_us: int) -> bool:
        return self.window.start_us <= epoch_us < self.window.stop_us

    def _reaches(self, command: Command) -> bool:
        return command.stop_us >= self.window.start_us and command.start_us < self.window.stop_us


def _left_out(histories: Sequence[History]) -> set[tuple[int, int]]:
    return {ends for history in histories for ends in history.left_out_us}


def _runs(method: Method, runs: Sequence[StateRun]) -> Iterator[documents.StateRunAnswer]:
    for (kind, name, carrier), start_us, stop_us, rows in runs:
        members = {"kind": kind, "name": name, "carrier": carrier or None, "rows": rows}
        yield documents.StateRunAnswer.model_validate({"method": method, "start": start_us, "stop": stop_us, **members})
