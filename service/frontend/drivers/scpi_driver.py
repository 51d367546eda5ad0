"""An analyzer spoken to in SCPI, in the words of one dialect.

One sweep takes two round trips: ``INIT;*OPC?`` bounded by one and a half sweep times, then trace, status, time,
settings and error queue in one message. The trace counts only when the queue is free of execution and command errors -
after a refused ``INIT`` the analyzer would give the previous trace with a good conscience - and when the settings after
it are those before it.

Traces in the format that the analyzer takes: blocks of numbers, text, and text in blocks.

Law of this file: a trace has as many levels as the analyzer states points, or it is no trace. The trace's own number
counts only where the analyzer states none, or belongs to a family that is known to state wrong ones.
"""

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from service.core.radio.levels import mw_from_dbm
from service.frontend.drivers.configuration import Configuration
from service.frontend.drivers.dialects import Dialect, Features, SweepRefusedError
from service.frontend.drivers.dialogue import Dialogue
from service.frontend.drivers.scpi import (
    AnalyzerMessage,
    AnswerError,
    FloatArray,
    Identity,
    is_message,
    levels_of_block,
    levels_of_text,
    parse_date_time,
    parse_message,
    parse_number,
    split_answers,
)
from service.frontend.drivers.visa_session import AnalyzerIOError, VisaSession
from service.frontend.measurement_task import InputPart, SweepPart
from service.records.epoch import US_PER_S, parse_epoch
from service.records.levels.sweep import SWEEP_FLAGS, Sweep, SweepSettings

#: what an analyzer sends that has no trace yet
_NO_TRACE = "#0"
#: no input stands more than 10 W; 107 dB more is what microvolts show
_MOST_DBM = 40.0
#: a trace of fewer points is none
FEWEST_POINTS = 11
#: a trace that keeps this close to zero is one in watts or volts
_FLAT_DB = 0.1


class TraceReader:
    """Reads the traces of one session.

    Parameters
    ----------
    dialogue : Dialogue
        Questions and answers.
    dialect : Dialect
        Words of the family.
    configuration : Configuration
        Knows the format in which traces are sent.
    """

    def __init__(self, dialogue: Dialogue, dialect: Dialect, configuration: Configuration) -> None:
        self._dialogue = dialogue
        self._dialect = dialect
        self._configuration = configuration

    def read(self, further: list[str]) -> tuple[bytes | str, list[str]]:
        """Return the trace as it came, and the answers to further queries, the last one the error queue's."""
        joined = further if self._dialogue.is_joining else []
        payload, line = self._dialogue.session.query_block(";".join([self._dialect.trace_query, *joined]))
        answers = split_answers(line)
        if not self._dialogue.is_joining:
            answers += self._dialogue.ask(further)
        if len(answers) != 1 + len(further):
            if is_message(answers[-1]):
                self._dialogue.raise_on_errors("the trace", parse_message(answers[-1]))
            message = f"{self._dialect.trace_query} and {';'.join(further)}"
            reason = f"{len(answers)} answers to {1 + len(further)} queries {message}: {line[-120:]!r}"
            raise AnalyzerIOError(f"{self._dialogue.session.resource} gave {reason}")
        first = answers.pop(0)
        if payload is None and first.strip() in {_NO_TRACE, ""}:
            raise SweepRefusedError(f"{self._dialogue.session.resource} has no trace to give")
        return (first if payload is None else payload), answers

    def levels(self, trace: bytes | str, points: int) -> FloatArray:
        """Return the levels of a trace, dBm.

        Raises
        ------
        AnswerError
            The trace does not have so many points.
        """
        levels = self._read_levels(trace, points)
        _require_dbm(levels)
        return levels

    def _read_levels(self, trace: bytes | str, points: int) -> FloatArray:
        """Return the numbers of a trace."""
        wanted = self._configuration.format
        if isinstance(trace, str) or not wanted.is_binary:
            return self._of_text(trace if isinstance(trace, str) else trace.decode("ascii"), points)
        if len(trace) == 8 * points or len(trace) % 4:
            # Doubles, or something that is no floats at all: the analyzer did not mean the format that it took.
            return self._again_as_text(points)
        return levels_of_block(trace, points, is_big_endian=wanted.is_big_endian)

    def _again_as_text(self, points: int) -> FloatArray:
        """Ask for the same trace as text, from now on."""
        self._configuration.read_text()
        payload, line = self._dialogue.session.query_block(self._dialect.trace_query)
        return self._of_text(line if payload is None else payload.decode("ascii"), points)

    def _of_text(self, text: str, points: int) -> FloatArray:
        """Return the levels of text; its own number of them where the analyzer states none, or a wrong one as known."""
        own = len(text.strip().strip(",").split(","))
        is_own = own == self._dialect.fixed_points or (not self._configuration.has_points and own >= FEWEST_POINTS)
        return levels_of_text(text, own if is_own else points)


def _require_dbm(levels: FloatArray) -> None:
    """Raise when a trace cannot be in dBm, whatever unit the analyzer says."""
    present = levels[np.isfinite(levels)]
    if present.size and (present.max() > _MOST_DBM or np.abs(present).max() < _FLAT_DB):
        message = f"levels from {present.min():g} to {present.max():g} are not in dBm"
        raise AnswerError(message)


#: a reset may take this long, s
RESET_S = 20.0
#: time between two questions for the end of a sweep, s
_POLL_S = 0.02


class ScpiDriver:
    """Drive one analyzer through one session.

    Parameters
    ----------
    session : VisaSession
        Open session; the driver closes it.
    identity : Identity
        What ``*IDN?`` answered.
    dialect : Dialect
        Words of its family.
    now_us : callable
        Present, microseconds UTC, for the epochs of sweeps under the system's clock.
    use_analyzer_clock : bool
        Take epochs from the analyzer where it has a clock.
    io_timeout_s : float
        Bound on an answer; of a sweep, beyond one and a half sweep times.
    hold_s : float
        Further wait for a sweep that a trigger holds back.
    enbw_ratio : float, optional
        Noise bandwidth over RBW, in place of the dialect's.
    """

    def __init__(
        self,
        session: VisaSession,
        identity: Identity,
        dialect: Dialect,
        now_us: Callable[[], int],
        *,
        use_analyzer_clock: bool = False,
        io_timeout_s: float = 5.0,
        hold_s: float = 0.0,
        enbw_ratio: float | None = None,
    ) -> None:
        self.identity = identity
        self.dialect = dialect
        self.features = Features(has_status=False, has_dwell_epoch=False, has_clock=False)
        self._session = session
        self._now_us = now_us
        self._use_analyzer_clock = use_analyzer_clock
        self._io_timeout_s = io_timeout_s
        self._hold_s = hold_s
        self._is_bound = False
        self._has_sweep_end = False
        self._dialogue = Dialogue(session)
        self._configuration = Configuration(self._dialogue, dialect, enbw_ratio)
        self._traces = TraceReader(self._dialogue, dialect, self._configuration)
        self._asked: tuple[SweepPart, InputPart] | None = None
        self._settings: SweepSettings | None = None
        self._previous: dict[str, tuple[bytes | str, int]] = {}

    @property
    def analyzer_messages(self) -> list[AnalyzerMessage]:
        """Errors of the analyzer that did not spoil a sweep, oldest first; the caller empties it."""
        return self._dialogue.analyzer_messages

    @property
    def foreign_changes(self) -> int:
        """How often settings were found changed by somebody else."""
        return self._configuration.foreign_changes

    def close(self) -> None:
        """Close the session."""
        self._session.close()

    def release(self) -> None:
        """Return the instrument to local control at its front panel."""
        if self.dialect.local and not self._is_bound:
            self._dialogue.report(self.dialect.local)
            # What it does not understand must not be found after the next sweep.
            self._is_bound = any(entry.is_command_error for entry in self._dialogue.drain())

    def preset(self) -> None:
        """Reset the analyzer, stop its own sweeping, set method and trace format, find out what it can be asked for."""
        self._dialogue.find_out_joining()
        application = self.dialect.application
        if application is not None:
            self._enter(application.header, application.value, application.stands)
        self._dialogue.report("*RST;*CLS")
        self._session.query("*OPC?", max(RESET_S, self._io_timeout_s))
        self._dialogue.raise_on_errors("preset")
        self._configuration.preset()
        self._has_sweep_end = bool(self.dialect.sweep_end) and self._knows(self.dialect.sweep_end)
        self.features = Features(
            has_status=self._knows(":STAT:QUES:COND?"),
            has_dwell_epoch=self._knows(":SIM:EPOCH?"),
            has_clock=self._knows(":SYST:DATE?;:SYST:TIME?"),
        )
        if self._use_analyzer_clock and not (self.features.has_dwell_epoch or self.features.has_clock):
            raise SweepRefusedError(f"{self._session.resource} has no clock to take epochs from; use the system's")

    def _enter(self, header: str, value: str, stands: Callable[[str], bool]) -> None:
        """Change to the spectrum analyzer of an instrument that can be several things."""
        answer = self._dialogue.try_ask(f"{header}?")
        if answer and not stands(answer):
            self._dialogue.report(f"{header} {value}")
            self._session.query("*OPC?", max(RESET_S, self._io_timeout_s))

    def _knows(self, query: str) -> bool:
        return self._dialogue.try_ask(query) is not None

    def configure(self, sweep: SweepPart, path: InputPart) -> SweepSettings:
        """Send the settings that differ from those sent last, read all back, and return the actual ones.

        Settings that somebody else changed meanwhile are sent once more; what the analyzer then still has
        differently stands as its own choice and is flagged.

        Raises
        ------
        SweepRefusedError
            A setting without which levels are wrong does not stand.
        """
        self._asked = (sweep, path)
        self._settings = self._configuration.configure(sweep, path)
        return self._settings

    def measure(self, sweep: SweepPart) -> Sweep:
        """Take ``sweep.count`` sweeps and return their mean in milliwatts."""
        taken = [self._checked_sweep(sweep.id) for _ in range(sweep.count)]
        if len(taken) == 1:
            return taken[0]
        first, last = taken[0], taken[-1]
        return Sweep(
            sweep.id,
            (first.epoch_us + last.epoch_us) // 2,
            first.settings,
            np.mean([each.power_mw for each in taken], axis=0),
            **{name: any(getattr(each, name) for each in taken) for name in SWEEP_FLAGS},
        )

    def _checked_sweep(self, sweep_id: str) -> Sweep:
        """Take one sweep; one whose settings were changed is taken again, and is no measurement the second time."""
        try:
            sweep, is_unchanged = self._sweep_once(sweep_id)
        except SweepRefusedError:
            # A setting changed during the sweep leaves no trace to give.
            if self._configuration.is_unchanged(self._dialogue.ask(self._configuration.readback)):
                raise
        else:
            if is_unchanged:
                return sweep
        if self._asked is not None:
            self.configure(*self._asked)
        sweep, is_unchanged = self._sweep_once(sweep_id)
        power_mw = sweep.power_mw if is_unchanged else np.full(sweep.power_mw.size, np.nan)
        return replace(sweep, power_mw=power_mw, is_setting_mismatch=True)

    def _sweep_once(self, sweep_id: str) -> tuple[Sweep, bool]:
        """Take one sweep; tell whether its settings stood to its end."""
        settings = self._settings
        if settings is None:
            raise SweepRefusedError(f"sweep {sweep_id} was not configured")
        system_us = self._sweep(settings)
        readback = self._configuration.readback
        trace, answers = self._traces.read([*self._after_trace(), *readback, ":SYST:ERR?"])
        self._dialogue.raise_on_errors(f"sweep {sweep_id}", parse_message(answers.pop()))
        stated = [answers.pop() for _ in readback][::-1]
        is_unchanged = self._configuration.is_unchanged(stated)
        condition = int(parse_number(answers.pop(0), ":STAT:QUES:COND?")) if self.features.has_status else 0
        epoch_us = self._epoch_us(answers, settings, system_us)
        # What was swept under foreign settings may not even be read: it has another unit, or other points.
        levels = self._traces.levels(trace, settings.points) if is_unchanged else np.full(settings.points, np.nan)
        taken = Sweep(
            sweep_id,
            epoch_us,
            replace(settings, points=levels.size),
            mw_from_dbm(levels),
            bool(condition & self.dialect.power_bits) or self._is_saturated(levels),
            bool(condition & self.dialect.calibration_bits),
            bool(condition & self.dialect.frequency_bits),
            self._is_stale(sweep_id, trace, epoch_us),
            self._configuration.is_mismatch,
        )
        return taken, is_unchanged

    def _is_saturated(self, levels: FloatArray) -> bool:
        """Return whether a trace reaches the reference level that the task names."""
        reference_dbm = None if self._asked is None else self._asked[1].ref_level_dbm
        present = levels[np.isfinite(levels)]
        return reference_dbm is not None and bool((present >= reference_dbm).any())

    def _sweep(self, settings: SweepSettings) -> int:
        """Sweep once and wait for its end; return the middle between start and end by the system's clock."""
        begun_us, begun_s = self._now_us(), time.monotonic()
        sweep_s = 1.5 * settings.sweep_time_s
        done = self._session.await_answer(
            ":INIT;*OPC?", sweep_s + self._io_timeout_s + self._hold_s, sweep_s + self._io_timeout_s
        )
        if done.strip().lstrip("+") != "1":
            raise AnalyzerIOError(f"{self._session.resource} answered *OPC? with {done[:40]!r}")
        if self._has_sweep_end and time.monotonic() - begun_s < settings.sweep_time_s:
            self._await_end(begun_s + sweep_s)
        return (begun_us + self._now_us()) // 2

    def _await_end(self, deadline_s: float) -> None:
        """Ask for the end of the sweep; one and a half sweep times are enough, whatever is answered."""
        while self._dialogue.ask([self.dialect.sweep_end])[0].strip() != "1" and time.monotonic() < deadline_s:
            time.sleep(_POLL_S)

    def _after_trace(self) -> list[str]:
        """Return the queries of status and time."""
        queries = [":STAT:QUES:COND?"] if self.features.has_status else []
        if self._use_analyzer_clock:
            queries += [":SIM:EPOCH?"] if self.features.has_dwell_epoch else [":SYST:DATE?", ":SYST:TIME?"]
        return queries

    def _is_stale(self, sweep_id: str, trace: bytes | str, epoch_us: int) -> bool:
        """Return whether a trace repeats the one before it."""
        previous_trace, previous_us = self._previous.get(sweep_id, (b"", 0))
        self._previous[sweep_id] = (trace, epoch_us)
        return previous_trace == trace and (previous_us == epoch_us or not self._use_analyzer_clock)

    def _epoch_us(self, answers: list[str], settings: SweepSettings, system_us: int) -> int:
        """Return the middle of the dwell by the clock in use."""
        if not self._use_analyzer_clock:
            return system_us
        if self.features.has_dwell_epoch:
            return parse_epoch(answers[0].strip("\"'"))
        end_us = parse_epoch(parse_date_time(answers[0], answers[1]))
        return end_us - round(settings.sweep_time_s * US_PER_S / 2)
