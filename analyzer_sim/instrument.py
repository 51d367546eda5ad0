"""The instrument behind the parser: settings, sweep, status. No socket, no SCPI text, no clock but the virtual one.

Sweeps and the virtual clock:

* A single sweep (``INIT:CONT OFF``, then ``INIT``) moves the world to its next row; a count above one combines that
  many sweeps of the same row. When the row is allowed the sweep is complete at once; otherwise it stays pending
  (OPERation bit 5, waiting for trigger) until :meth:`Instrument.complete_pending` finds it allowed.
* In ``INIT:CONT ON`` every trace query shows a fresh sweep of the present row; the clock stands still.
* After the last row ``INIT`` queues -200 and leaves no trace, so that the next trace query gives -230.
* A list sweep measures every entry with its own settings, all of them on one row.
"""

from collections.abc import Callable
from functools import reduce
from operator import or_

from analyzer_sim.analyzer_model import AnalyzerModel
from analyzer_sim.emission import Emission, EmissionSource
from analyzer_sim.function_settings import FunctionSettings, swept_settings
from analyzer_sim.instrument_settings import Settings, reset_state
from analyzer_sim.models import FSW_26
from analyzer_sim.painter import Trace, TracePainter
from analyzer_sim.scpi_errors import ScpiError
from analyzer_sim.status import (
    ESR_OPERATION_COMPLETE,
    OPERATION_WAITING_FOR_TRIGGER,
    QUESTIONABLE_CALIBRATION,
    StatusModel,
)
from analyzer_sim.trace_faults import TraceFaults
from analyzer_sim.world import EndOfScenario


def _always() -> bool:
    return True


class Instrument:
    """One spectrum analyzer, shared by all sessions.

    Parameters
    ----------
    source : EmissionSource
        The world at the input.
    painter : TracePainter
        Draws the traces.
    may_advance : callable
        Whether the next row may be swept now.
    model : AnalyzerModel
        Figures of the make.
    """

    def __init__(
        self,
        source: EmissionSource,
        painter: TracePainter,
        may_advance: Callable[[], bool] = _always,
        model: AnalyzerModel = FSW_26,
    ) -> None:
        self.model = model
        self.settings = reset_state(model)
        self.functions = FunctionSettings()
        self.status = StatusModel(model.error_queue_depth, model.no_error)
        #: faults of what is shown, for tests of clients
        self.trace_faults = TraceFaults()
        self._source = source
        self._painter = painter
        self._may_advance = may_advance
        self._trace: Trace | None = None
        self._list_entries: tuple[Settings, ...] = ()
        self._list_traces: tuple[Trace, ...] = ()
        self._is_pending = False
        self._completion_wanted = False

    @property
    def is_pending(self) -> bool:
        """Whether a sweep waits for permission."""
        return self._is_pending

    @property
    def swept(self) -> Settings:
        """The settings a sweep is taken with: those of the measurement selected."""
        return swept_settings(self.settings, self.functions)

    def reset(self, *, is_preset: bool = False) -> None:
        """``*RST``, or ``SYSTem:PRESet``: settings to their defaults; status and queues stay."""
        self._completion_wanted = False
        self.abort()
        self.settings = reset_state(self.model, is_preset=is_preset)
        self.functions = FunctionSettings()
        self.invalidate()

    def initiate(self) -> None:
        """Start a single sweep.

        Raises
        ------
        ScpiError
            -213 when the instrument sweeps continuously or a sweep is pending.
        """
        if self.settings.is_continuous:
            raise ScpiError(-213, "INIT:CONT is ON")
        if self._is_pending:
            raise ScpiError(-213, "a sweep is pending")
        self.invalidate()
        self._begin()

    def _begin(self) -> None:
        self._is_pending = True
        self.status.operation.put_bit(OPERATION_WAITING_FOR_TRIGGER, is_set=True)
        self.complete_pending()

    def initiate_list(self, entries: tuple[Settings, ...]) -> None:
        """Start a sweep that measures each entry once with its own settings.

        Raises
        ------
        ScpiError
            -213 when a sweep is pending.
        """
        if self._is_pending:
            raise ScpiError(-213, "a sweep is pending")
        self.invalidate()
        self._list_entries = entries
        self._begin()

    def complete_pending(self) -> bool:
        """Run the pending sweep if its row is allowed; return whether none is pending any more."""
        if self._is_pending and self._may_advance():
            try:
                self._show(self._source.advance())
            except EndOfScenario:
                self.status.push_error(-200, "the scenario has ended; there is no further row to sweep")
            self._end_pending()
        return not self._is_pending

    def abort(self) -> None:
        """``ABORt``: forget the pending sweep; operations are then complete."""
        if self._is_pending:
            self._end_pending()

    def _end_pending(self) -> None:
        self._is_pending = False
        self._list_entries = ()
        self.status.operation.put_bit(OPERATION_WAITING_FOR_TRIGGER, is_set=False)
        if self._completion_wanted:
            self.report_completion()

    def report_completion(self) -> None:
        """``*OPC``: set the operation-complete bit now, or when the pending sweep ends."""
        self._completion_wanted = self._is_pending
        if not self._is_pending:
            self.status.event |= ESR_OPERATION_COMPLETE

    def forget_completion(self) -> None:
        """Take back ``*OPC``: a device clear does not wait for the sweep any more."""
        self._completion_wanted = False

    def invalidate(self) -> None:
        """Forget the trace and the results of a list: a setting that shapes them has changed."""
        self._trace = None
        self._list_traces = ()

    def trace(self) -> Trace:
        """Return the trace to show.

        Raises
        ------
        ScpiError
            -230 when no sweep has been taken with the present settings.
        """
        if self.settings.is_continuous:
            self._show(self._present())
        if self._trace is None:
            raise ScpiError(-230, "no sweep with the present settings")
        return self._trace

    def list_traces(self) -> tuple[Trace, ...]:
        """Return the traces of the last list sweep, one an entry.

        Raises
        ------
        ScpiError
            -230 when no list has been swept with the present settings.
        """
        if not self._list_traces:
            raise ScpiError(-230, "no list has been swept")
        return self._list_traces

    def epoch_us(self) -> int:
        """Return the virtual instant: of the trace shown, else of the present row."""
        return self._present().epoch_us if self._trace is None else self._trace.epoch_us

    def _present(self) -> Emission:
        try:
            return self._source.current()
        except EndOfScenario:
            raise ScpiError(-230, "the scenario has ended") from None

    def _show(self, emission: Emission) -> None:
        entries = self._list_entries or (self.swept,)
        traces = tuple(self._painter.paint(emission, entry, len(entries)) for entry in entries)
        if self._list_entries:
            self._list_traces = traces
        else:
            self._trace = traces[0]
        self.status.put_questionable_power(reduce(or_, (trace.overload for trace in traces)))
        is_uncalibrated = any(entry.is_uncalibrated for entry in entries)
        self.status.questionable.put_bit(QUESTIONABLE_CALIBRATION, is_set=is_uncalibrated)
