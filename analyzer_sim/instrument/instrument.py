"""The instrument behind the parser: settings, sweep, status. No socket, no SCPI text.

Sweeps, the world and the clocks (states of a sweep: ``sweep_progress.py``):

* A single sweep (``INIT:CONT OFF``, then ``INIT``) moves the world to its next row; a count above one combines that
  many sweeps of the same row. The row must be allowed; until then the sweep is pending.
* At the virtual pace an allowed sweep is complete at once. At the real pace it lasts its sweep time by the wall clock
  and shows, when that is over, the row that follows the one shown last: the wall clock decides when a row is shown, the
  rows alone decide what time it is in the world, whatever the sweep took. For a world that keeps step with the wall
  clock choose its row period equal to the period of the client's measurements. A sweep that is aborted takes no row.
* In ``INIT:CONT ON`` every trace query shows a fresh sweep of the present row and the world stands still; at the real
  pace the trace is a fresh one once a sweep time, and the first one after a change of settings is waited for.
* After the last row ``INIT`` queues -200 and leaves no trace, so that the next trace query gives -230.
"""

from collections.abc import Callable
from functools import reduce
from operator import or_

from analyzer_sim.emission import Emission, EmissionSource, EndOfScenario
from analyzer_sim.instrument.channel_power import ChannelSettings, own_sweep_settings
from analyzer_sim.instrument.imperfections import TraceFaults
from analyzer_sim.instrument.instrument_settings import FSW_26, AnalyzerModel, Settings, reset_state
from analyzer_sim.instrument.painter import Trace, TracePainter
from analyzer_sim.instrument.sweep_progress import OPERATION_BITS, Pace, SweepProgress, SweepState
from analyzer_sim.instrument.truth_log import Reading, TruthLog
from analyzer_sim.scpi.errors import ScpiError
from analyzer_sim.scpi.status import ESR_OPERATION_COMPLETE, StatusModel
from analyzer_sim.streams import FloatArray

#: all bits of OPERation:CONDition that sweeps decide
_SWEEP_BITS = reduce(or_, OPERATION_BITS.values())


def _always() -> bool:
    return True


class TraceNotReadyError(Exception):
    """The first sweep with the present settings is not complete; query again later."""


class Instrument:
    """One spectrum analyzer, shared by all sessions.

    Parameters
    ----------
    source : EmissionSource
        The world at the input.
    painter : TracePainter
        Draws the traces.
    may_advance : callable
        True when the next row may be swept now.
    model : AnalyzerModel
        Limits and errors of the make.
    progress : SweepProgress, optional
        How long sweeps last; at the virtual pace when left out.
    truth : TruthLog, optional
        Where completed sweeps and delivered traces are written.
    """

    def __init__(
        self,
        source: EmissionSource,
        painter: TracePainter,
        may_advance: Callable[[], bool] = _always,
        model: AnalyzerModel = FSW_26,
        progress: SweepProgress | None = None,
        truth: TruthLog | None = None,
    ) -> None:
        self.model = model
        self.settings = reset_state(model)
        self.channel = ChannelSettings(model.channel_width_hz.default)
        self.status = StatusModel(model.error_queue_depth, model.no_error)
        #: faults of what is shown, for tests of clients
        self.trace_faults = TraceFaults()
        self._source = source
        self._painter = painter
        self._may_advance = may_advance
        self._trace: Trace | None = None
        self._progress = progress or SweepProgress()
        self._truth = truth
        self._sweeps = 0
        self._repeats_shown = 0
        self._readings: list[Reading] = []
        self._completion_wanted = False
        self._sweep_errors = self.status.errors

    @property
    def is_pending(self) -> bool:
        """Return whether a single sweep waits for permission or runs."""
        return self._progress.is_pending

    @property
    def is_waiting(self) -> bool:
        """Return whether a single sweep waits for permission."""
        return self._progress.state is SweepState.WAITING

    @property
    def changes(self) -> int:
        """Changes in the life of sweeps so far."""
        return self._progress.changes

    @property
    def remaining_s(self) -> float | None:
        """Time until the sweep that runs is complete; ``None`` when no time is waited for."""
        return self._progress.remaining_s

    @property
    def sweep_settings(self) -> Settings:
        """The settings a sweep is taken with: those of the measurement selected."""
        is_own = self.channel.is_selected and self.channel.is_own_sweep
        return own_sweep_settings(self.settings, self.channel) if is_own else self.settings

    def reset(self, *, is_preset: bool = False) -> None:
        """``*RST``, or ``SYSTem:PRESet``: settings to their defaults; status and queues stay."""
        self._completion_wanted = False
        self.abort()
        self.settings = reset_state(self.model, is_preset=is_preset)
        self.channel = ChannelSettings(self.model.channel_width_hz.default)
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
        if self.is_pending:
            raise ScpiError(-213, "a sweep is pending")
        self.invalidate()
        self._sweep_errors = self.status.errors
        self._progress.wait()
        self._report_progress()
        self.complete_pending()

    def complete_pending(self) -> bool:
        """Begin the pending sweep if its row is allowed, end it if its time is over; return whether none is pending."""
        progress = self._progress
        if self.is_waiting and self._may_advance():
            if progress.pace is Pace.VIRTUAL:
                self._complete()
            else:
                progress.start(self._duration_s())
                self._report_progress()
        if progress.is_due:
            self._complete()
        return not progress.is_pending

    def _complete(self) -> None:
        try:
            self._show(self._source.advance())
        except EndOfScenario:
            self.status.errors = self._sweep_errors  # of the session that asked, where each has its own
            self.status.push_error(-200, "the scenario has ended; there is no further row to sweep")
        self._end_pending()

    def keep_continuous(self) -> None:
        """Let sweeps follow one another while ``INIT:CONT`` is ON; at the virtual pace they take no time."""
        if self._progress.pace is Pace.VIRTUAL or self.is_pending:
            return
        is_repeating = self._progress.state is SweepState.CONTINUOUS
        if self.settings.is_continuous and not is_repeating:
            self._progress.repeat(self._duration_s())
            self._report_progress()
        elif is_repeating and not self.settings.is_continuous:
            self._progress.end()
            self._report_progress()

    def _duration_s(self) -> float:
        """Return how long the sweeps of one trace last."""
        settings = self.sweep_settings
        return settings.time_s * settings.sweeps

    def _report_progress(self) -> None:
        others = self.status.operation.condition & ~_SWEEP_BITS
        self.status.operation.put_condition(others | OPERATION_BITS[self._progress.state])

    def abort(self) -> None:
        """``ABORt``: forget the pending sweep; operations are then complete. Sweeps without end begin again."""
        if self.is_pending:
            self._end_pending()
        else:
            self._restart()

    def _end_pending(self) -> None:
        self._progress.end()
        self._report_progress()
        if self._completion_wanted:
            self.report_completion()

    def report_completion(self) -> None:
        """``*OPC``: set the operation-complete bit now, or when the pending sweep ends."""
        self._completion_wanted = self.is_pending
        if not self.is_pending:
            self.status.event |= ESR_OPERATION_COMPLETE

    def forget_completion(self) -> None:
        """Take back ``*OPC``: a device clear does not wait for the sweep any more."""
        self._completion_wanted = False

    def invalidate(self) -> None:
        """Forget what was swept: a setting that shapes it has changed; the sweep that runs begins again."""
        self._trace = None
        self._restart()

    def _restart(self) -> None:
        if self._progress.is_running:
            self._progress.restart(self._duration_s())

    def trace(self) -> Trace:
        """Return the trace to show.

        Raises
        ------
        ScpiError
            -230 when no sweep has been taken with the present settings.
        TraceNotReadyError
            Sweeps follow one another and the first one is not complete.
        """
        if self.settings.is_continuous and self._has_fresh_sweep():
            self._show(self._present())
        if self._trace is None:
            raise ScpiError(-230, "no sweep with the present settings")
        return self._trace

    def _has_fresh_sweep(self) -> bool:
        """Tell whether a sweep without end has been completed since the trace was drawn."""
        if self._progress.pace is Pace.VIRTUAL:
            return True
        self.keep_continuous()
        repeats = self._progress.sweeps_done
        if not repeats:
            raise TraceNotReadyError
        is_fresh = self._trace is None or repeats != self._repeats_shown
        self._repeats_shown = repeats
        return is_fresh

    def read_out(self, shown: FloatArray) -> FloatArray:
        """Return the numbers of a trace as they leave, shape (B,): noted for the truth log, wrong if so armed."""
        leaving = self.trace_faults.spoil(shown)
        self._readings.append(Reading(self._sweeps, leaving is not shown))
        return leaving

    def measured_readings(self) -> tuple[Reading, ...]:
        """Return the traces read since this was asked last."""
        readings = tuple(self._readings)
        self._readings.clear()
        return readings

    def report_delivery(self, readings: tuple[Reading, ...], session: str) -> None:
        """Note that answers with these traces have left whole."""
        if self._truth is not None:
            for reading in readings:
                self._truth.trace(reading, session)

    def epoch_us(self) -> int:
        """Return the virtual instant: of the trace shown, else of the present row."""
        return self._present().epoch_us if self._trace is None else self._trace.epoch_us

    def _present(self) -> Emission:
        try:
            return self._source.current()
        except EndOfScenario:
            raise ScpiError(-230, "the scenario has ended") from None

    def _show(self, emission: Emission) -> None:
        settings = self.sweep_settings
        self._trace = self._painter.paint(emission, settings)
        self._sweeps += 1
        if self._truth is not None:
            self._truth.sweep(self._sweeps, emission, settings)
        self.status.put_questionable_power(self._trace.overload)
        self.status.put_uncalibrated(self.model.uncalibrated_bit, is_set=settings.is_uncalibrated)
