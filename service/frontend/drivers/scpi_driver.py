"""An analyzer spoken to in SCPI, in the words of one dialect.

One sweep takes two round trips: ``INIT;*OPC?`` bounded by one and a half sweep times, then trace, status, time and
error queue in one message. The trace counts only when the queue is free of execution and command errors: after a
refused ``INIT`` the analyzer would give the previous trace with a good conscience.
"""

from collections.abc import Callable

import numpy as np

from service.core.radio.decibel import mw_from_dbm
from service.frontend.drivers.base import Dialect, Features, SweepRefusedError
from service.frontend.measurement_task import InputPart, SweepPart
from service.frontend.scpi import (
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
from service.frontend.visa_session import AnalyzerIOError, VisaSession
from service.records.epoch import US_PER_S, parse_epoch
from service.records.sweep import Sweep, SweepSettings

#: bits of the questionable-status register (SCPI-99, 20.3)
POWER_BIT, FREQUENCY_BIT, CALIBRATION_BIT = 1 << 3, 1 << 5, 1 << 8
#: the queue holds 20 to 30 entries; more means that it never empties
MAX_QUEUE = 64
#: deviation of an edge, in spans, that counts as "not what was asked for"
SETTING_TOLERANCE = 1e-3

_READBACK = ":FREQ:STAR?;:FREQ:STOP?;:BAND?;:BAND:VID?;:SWE:POIN?;:SWE:TIME?;:SYST:ERR?"


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
    ) -> None:
        self.identity = identity
        self.dialect = dialect
        self.features = Features(has_status=False, has_dwell_epoch=False, has_clock=False)
        #: errors of the analyzer that did not spoil a sweep, oldest first; the caller empties it
        self.remarks: list[AnalyzerMessage] = []
        self._session = session
        self._now_us = now_us
        self._use_analyzer_clock = use_analyzer_clock
        self._io_timeout_s = io_timeout_s
        self._hold_s = hold_s
        self._is_binary = bool(dialect.binary_format)
        self._sent: dict[str, str] = {}
        self._settings: SweepSettings | None = None
        self._is_mismatch = False
        self._previous: dict[str, tuple[bytes | str, int]] = {}

    def close(self) -> None:
        """Close the session."""
        self._session.close()

    def preset(self) -> None:
        """Reset the analyzer, stop its own sweeping, choose the trace format, find out what it can be asked for."""
        self._session.write("*RST;*CLS")
        self._session.query("*OPC?")
        self._sent.clear()
        self._session.write(":INIT:CONT OFF")
        self._raise_on_errors("preset")
        if self._is_binary:
            self._session.write(f":FORM {self.dialect.binary_format}")
            self._is_binary = not any(m.is_command_error or m.is_execution_error for m in self._drain())
        if not self._is_binary:
            self._session.write(":FORM ASC")
        self._raise_on_errors("format")
        self.features = Features(
            has_status=self._answers(":STAT:QUES:COND?"),
            has_dwell_epoch=self._answers(":SIM:EPOCH?"),
            has_clock=self._answers(":SYST:DATE?;:SYST:TIME?"),
        )
        if self._use_analyzer_clock and not (self.features.has_dwell_epoch or self.features.has_clock):
            raise SweepRefusedError(f"{self._session.resource} has no clock to take epochs from; use the system's")

    def configure(self, sweep: SweepPart, path: InputPart) -> SweepSettings:
        """Send the settings that differ from those sent last, read all back, and return the actual ones.

        Settings that somebody else changed meanwhile are sent once more; what the analyzer then still has
        differently stands as its own choice and is flagged.
        """
        self._settings = self._send(sweep, path)
        self._is_mismatch = _differs(sweep, path, self._settings)
        if self._is_mismatch:
            self._sent = {}
            self._settings = self._send(sweep, path)
            self._is_mismatch = _differs(sweep, path, self._settings)
        return self._settings

    def _send(self, sweep: SweepPart, path: InputPart) -> SweepSettings:
        """Send what is not known to stand, and read everything back."""
        wanted = self._wanted(sweep, path)
        changed = [f"{header} {value}" for header, value in wanted.items() if self._sent.get(header) != value]
        if changed:
            self._session.write(";".join(changed))
            # Replaced, not merged: a sweep with coupled time forgets the time of the one before.
            self._sent = wanted
        answers = split_answers(self._session.query(_READBACK))
        if len(answers) != 7:
            raise AnalyzerIOError(f"{self._session.resource} read back {answers}")
        self._raise_on_errors("settings", parse_message(answers[6]))
        start_hz, stop_hz, rbw_hz, vbw_hz, points, time_s = map(parse_number, answers[:6])
        return SweepSettings(
            start_hz, stop_hz, int(points), rbw_hz, rbw_hz * self.dialect.enbw_ratio, vbw_hz, time_s, "RMS", sweep.count
        )

    def take(self, sweep: SweepPart) -> Sweep:
        """Take ``sweep.count`` sweeps and return their mean in milliwatts."""
        taken = [self._take_once(sweep.id) for _ in range(sweep.count)]
        if len(taken) == 1:
            return taken[0]
        first, last = taken[0], taken[-1]
        return Sweep(
            sweep.id,
            (first.epoch_us + last.epoch_us) // 2,
            first.settings,
            np.mean([each.power_mw for each in taken], axis=0),
            any(each.is_overrange for each in taken),
            any(each.is_uncalibrated for each in taken),
            any(each.is_reference_unlocked for each in taken),
            any(each.is_stale for each in taken),
            self._is_mismatch,
        )

    def _take_once(self, sweep_id: str) -> Sweep:
        """Take one sweep."""
        settings = self._settings
        if settings is None:
            raise SweepRefusedError(f"sweep {sweep_id} was not configured")
        begun_us = self._now_us()
        sweep_s = 1.5 * settings.sweep_time_s
        done = self._session.await_answer(
            ":INIT;*OPC?", sweep_s + self._io_timeout_s + self._hold_s, sweep_s + self._io_timeout_s
        )
        ended_us = self._now_us()
        if done.strip() != "1":
            raise AnalyzerIOError(f"{self._session.resource} answered *OPC? with {done[:40]!r}")
        trace, answers = self._read_trace()
        self._raise_on_errors(f"sweep {sweep_id}", parse_message(answers.pop()))
        condition = int(parse_number(answers.pop(0))) if self.features.has_status else 0
        epoch_us = self._epoch_us(answers, settings, (begun_us + ended_us) // 2)
        is_stale = self._previous.get(sweep_id) == (trace, epoch_us) or (
            not self._use_analyzer_clock and self._previous.get(sweep_id, (b"", 0))[0] == trace
        )
        self._previous[sweep_id] = (trace, epoch_us)
        return Sweep(
            sweep_id,
            epoch_us,
            settings,
            mw_from_dbm(self._levels(trace, settings.points)),
            bool(condition & POWER_BIT),
            bool(condition & CALIBRATION_BIT),
            bool(condition & FREQUENCY_BIT),
            is_stale,
            self._is_mismatch,
        )

    def _read_trace(self) -> tuple[bytes | str, list[str]]:
        """Return the trace as it came, and the answers after it: status, time, newest error."""
        queries = [self.dialect.trace_query]
        queries += [":STAT:QUES:COND?"] if self.features.has_status else []
        if self._use_analyzer_clock:
            queries += [self._clock_query()]
        queries.append(":SYST:ERR?")
        payload, line = self._session.query_block(";".join(queries))
        answers = split_answers(line)
        due = ";".join(queries).count("?")
        if len(answers) != due:
            if is_message(answers[-1]):
                self._raise_on_errors("the trace", parse_message(answers[-1]))
            reason = f"{len(answers)} answers to {due} queries: {line[-120:]!r}"
            raise AnalyzerIOError(f"{self._session.resource} gave {reason}")
        first = answers.pop(0)
        return (first if payload is None else payload), answers

    def _levels(self, trace: bytes | str, points: int) -> FloatArray:
        """Return the levels of a trace; a block that does not fit is asked for again as ASCII."""
        if isinstance(trace, str):
            return levels_of_text(trace, points)
        try:
            return levels_of_block(trace, points, is_big_endian=self.dialect.is_big_endian)
        except AnswerError:
            self._is_binary = False
            self._session.write(":FORM ASC")
            return levels_of_text(self._session.query(self.dialect.trace_query), points)

    def _epoch_us(self, answers: list[str], settings: SweepSettings, system_us: int) -> int:
        """Return the middle of the dwell by the clock in use."""
        if not self._use_analyzer_clock:
            return system_us
        if self.features.has_dwell_epoch:
            return parse_epoch(answers[0].strip("\"'"))
        end_us = parse_epoch(parse_date_time(answers[0], answers[1]))
        return end_us - round(settings.sweep_time_s * US_PER_S / 2)

    def _clock_query(self) -> str:
        """Return the query that tells the analyzer's time of a sweep."""
        return ":SIM:EPOCH?" if self.features.has_dwell_epoch else ":SYST:DATE?;:SYST:TIME?"

    def _wanted(self, sweep: SweepPart, path: InputPart) -> dict[str, str]:
        """Return header and value of every setting, in the order in which couplings want them."""
        start_hz, stop_hz = sweep.start_hz + path.freq_offset_hz, sweep.stop_hz + path.freq_offset_hz
        wanted = {
            ":FREQ:STAR": f"{start_hz:.3f}",
            ":FREQ:STOP": f"{stop_hz:.3f}",
            ":BAND": f"{sweep.rbw_hz:g}",
            ":BAND:VID": f"{10.0 * sweep.rbw_hz if sweep.vbw_hz is None else sweep.vbw_hz:g}",
            ":SWE:POIN": str(sweep.points),
            ":DET": sweep.detector,
        }
        wanted |= {":SWE:TIME:AUTO": "ON"} if sweep.time_s is None else {":SWE:TIME": f"{sweep.time_s:g}"}
        if path.ref_level_dbm is not None:
            wanted[self.dialect.reference_level] = f"{path.ref_level_dbm:g}"
        if path.attenuation_db is not None:
            wanted[self.dialect.attenuation] = f"{path.attenuation_db:g}"
        if path.preamp is not None:
            wanted[self.dialect.preamplifier] = "ON" if path.preamp else "OFF"
        return wanted

    def _answers(self, query: str) -> bool:
        """Return whether the analyzer knows a query, without waiting for an answer that never comes."""
        if len(split_answers(self._session.query(f"*OPC?;{query}"))) > 1:
            return True
        # A query that is known but has nothing to say now leaves an execution error, not a command error.
        return not any(entry.is_command_error for entry in self._drain())

    def _drain(self, first: AnalyzerMessage | None = None) -> list[AnalyzerMessage]:
        """Return all entries of the error queue."""
        entries: list[AnalyzerMessage] = []
        entry = first or parse_message(self._session.query(":SYST:ERR?"))
        while entry.code != 0:
            entries.append(entry)
            if len(entries) > MAX_QUEUE:
                raise AnalyzerIOError(f"{self._session.resource} has an error queue without end")
            entry = parse_message(self._session.query(":SYST:ERR?"))
        return entries

    def _raise_on_errors(self, what: str, first: AnalyzerMessage | None = None) -> None:
        """Drain the error queue; raise when an entry says that something was not done."""
        entries = self._drain(first)
        refusals = [entry for entry in entries if entry.is_execution_error or entry.is_command_error]
        if refusals:
            told = "; ".join(f"{entry.code} {entry.text}" for entry in refusals)
            raise SweepRefusedError(f"{self._session.resource} refuses {what}: {told}")
        self.remarks += entries


def _differs(sweep: SweepPart, path: InputPart, actual: SweepSettings) -> bool:
    """Return whether the analyzer did not take span, points or time; its own RBW steps are no fault."""
    tolerance_hz = SETTING_TOLERANCE * (sweep.stop_hz - sweep.start_hz)
    is_start_off = abs(actual.start_hz - sweep.start_hz - path.freq_offset_hz) > tolerance_hz
    is_stop_off = abs(actual.stop_hz - sweep.stop_hz - path.freq_offset_hz) > tolerance_hz
    is_time_off = sweep.time_s is not None and abs(actual.sweep_time_s - sweep.time_s) > 0.1 * sweep.time_s
    is_rbw_off = not 0.5 < actual.rbw_hz / sweep.rbw_hz < 2.0
    return is_start_off or is_stop_off or is_time_off or is_rbw_off or actual.points != sweep.points
