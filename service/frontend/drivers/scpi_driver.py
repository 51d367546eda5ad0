"""An analyzer spoken to in SCPI, in the words of one dialect.

One sweep takes two round trips: ``INIT;*OPC?`` bounded by one and a half sweep times, then trace, status, time,
settings and error queue in one message. The trace counts only when the queue is free of execution and command errors -
after a refused ``INIT`` the analyzer would give the previous trace with a good conscience - and when the settings after
it are those before it.

Traces in the format that the analyzer takes: blocks of numbers, text, and text in blocks.

Law of this file: a trace has as many levels as the analyzer states points, or it is no trace. The trace's own number
counts only where the analyzer states none, or belongs to a family that is known to state wrong ones. Of settings,
what the analyzer states counts, not what it was told: one without which levels are wrong (unit, detector, kind of
average, trace that holds no maximum) either stands or the sweep is refused; any other value that the analyzer chooses
is used as it is and flagged.
"""

import math
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from service.core.radio.levels import mw_from_dbm
from service.frontend.drivers import scpi
from service.frontend.drivers.dialects import ASCII, SINGLE, Dialect, Features, SweepRefusedError, TraceFormat, Word
from service.frontend.drivers.dialogue import Dialogue
from service.frontend.drivers.visa_session import AnalyzerIOError, VisaSession
from service.frontend.measurement_task import InputPart, SweepPart
from service.records.epoch import US_PER_S, parse_epoch
from service.records.levels.attitude import FloatArray
from service.records.levels.measurement import SWEEP_FLAGS, Sweep, SweepSettings

#: deviation of an edge, in spans, that counts as "not what was asked for"
SETTING_TOLERANCE = 1e-3
#: deviation of a level setting that counts, dB: attenuators have steps
LEVEL_TOLERANCE_DB = 1.0

#: frequencies, bandwidths and time: what every analyzer can be asked
_NUMBERS = (":FREQ:STAR", ":FREQ:STOP", ":BAND", ":BAND:VID", ":SWE:TIME")


class Configuration:
    """Settings of one analyzer through one session.

    Parameters
    ----------
    dialogue : Dialogue
        Questions and answers.
    dialect : Dialect
        Words of the family.
    enbw_ratio : float, optional
        In place of the dialect's.
    """

    def __init__(self, dialogue: Dialogue, dialect: Dialect, enbw_ratio: float | None = None) -> None:
        #: settings were not taken as they were asked for
        self.is_mismatch = False
        #: settings that a read-back found changed by somebody else
        self.foreign_changes = 0
        #: how traces are sent
        self.format: TraceFormat = ASCII
        self._dialogue = dialogue
        self._dialect = dialect
        self._enbw_ratio = enbw_ratio or dialect.enbw_ratio
        self._words: list[Word] = []
        self._has_points = True
        self._without: set[str] = set()
        self._sent: dict[str, str] = {}
        self._levels: list[str] = []
        self._stated: list[str] = []
        #: what was stated for each sweep when it was configured last
        self._expected: dict[tuple[SweepPart, InputPart], list[str]] = {}

    def preset(self) -> None:
        """Set what stays the same for all sweeps, after a reset."""
        self._sent, self._stated, self._expected, self._without = {}, [], {}, set()
        self.format = self._choose_format()
        self._words = [word for word in (SINGLE, *self._dialect.method) if self._establish(word)]
        self._words += [*self._detector(), *self.format.words]
        self._has_points = self._dialogue.try_ask(f"{self._dialect.points}?") is not None

    def _choose_format(self) -> TraceFormat:
        """Set the first format of traces that the analyzer takes."""
        for wanted in self._dialect.formats:
            if all(self._dialogue.try_set(word) for word in wanted.words):
                return wanted
        raise SweepRefusedError(f"{self._dialogue.session.resource} takes no format of traces")

    def read_text(self) -> None:
        """Change to traces as text, for the rest of the session."""
        self._words = [word for word in self._words if word not in self.format.words] + [*ASCII.words]
        self.format = ASCII
        for word in ASCII.words:
            self._dialogue.report(f"{word.header} {word.value}")
        self._stated = self._dialogue.ask(self.readback)

    def _establish(self, word: Word) -> bool:
        """Set a word; return whether it can be read back. Without one that is needed there is no measuring."""
        stands = self._dialogue.try_set(word)
        if word.is_needed and not stands:
            reason = "cannot be asked for" if stands is None else "does not take"
            raise SweepRefusedError(f"{self._dialogue.session.resource} {reason} {word.header} {word.value}")
        return bool(stands)

    def _detector(self) -> tuple[Word, ...]:
        """Set the first way to the mean of powers that the analyzer takes."""
        for words in self._dialect.detectors:
            if all(self._dialogue.try_set(word) for word in words):
                return words
        raise SweepRefusedError(f"{self._dialogue.session.resource} has no detector for the mean of powers")

    @property
    def has_points(self) -> bool:
        """Return whether the analyzer states how many points it sweeps."""
        return self._has_points

    @property
    def readback(self) -> list[str]:
        """Queries that tell all settings in force."""
        points = [self._dialect.points] if self._has_points else []
        return [f"{header}?" for header in (*_NUMBERS, *points, *self._levels, *(w.header for w in self._words))]

    def is_unchanged(self, answers: list[str]) -> bool:
        """Return whether a read-back says what it said when the sweep was configured; count it otherwise."""
        if answers == self._stated:
            return True
        self.foreign_changes += 1
        self._sent, self._expected = {}, {}
        return False

    def configure(self, sweep: SweepPart, path: InputPart) -> SweepSettings:
        """Send the settings that differ from those sent last, read all back, and return the actual ones.

        What the analyzer states differently than it did for the same sweep before has been changed by somebody else.
        """
        settings = self._send(sweep, path)
        expected = self._expected.get((sweep, path))
        is_foreign = expected is not None and self._stated != expected
        if self.is_mismatch or is_foreign:
            self._sent = {}
            for word in self._words:
                self._dialogue.report(f"{word.header} {word.value}")
            settings = self._send(sweep, path)
        self.foreign_changes += is_foreign
        self._expected[sweep, path] = self._stated
        self._require_words()
        return settings

    def _send(self, sweep: SweepPart, path: InputPart) -> SweepSettings:
        """Send what is not known to stand, and read everything back."""
        wanted = self._wanted(sweep, path)
        self._send_points(wanted)
        changed = [f"{header} {value}" for header, value in wanted.items() if self._sent.get(header) != value]
        if changed:
            self._dialogue.report(";".join(changed))
            # Replaced, not merged: a sweep with coupled time forgets the time of the one before.
            self._sent = wanted
        *self._stated, newest = self._dialogue.ask([*self.readback, ":SYST:ERR?"])
        self._dialogue.raise_on_errors("settings", scpi.parse_message(newest))
        settings = self._settings(sweep)
        reported = dict(zip(self.readback, self._stated, strict=True))
        self.is_mismatch = (
            self._differs(sweep, path, settings)
            or any(not _level_stands(reported[f"{header}?"], wanted[header]) for header in self._levels)
            or any(not word.stands(reported[f"{word.header}?"]) for word in self._words)
        )
        return settings

    def _send_points(self, wanted: dict[str, str]) -> None:
        """Send the number of points alone to an analyzer that may refuse any; it then keeps its own."""
        header = self._dialect.points
        if self._dialect.fixed_points is None:
            return
        value = wanted.pop(header, None)
        if value is None or header in self._without or self._sent.get(header) == value:
            return
        self._dialogue.report(f"{header} {value}")
        if any(entry.is_command_error or entry.is_execution_error for entry in self._dialogue.drain()):
            self._without.add(header)
        self._sent[header] = value

    def _settings(self, sweep: SweepPart) -> SweepSettings:
        """Return the settings that the analyzer stated last."""
        stated = [
            scpi.parse_number(*pair) for pair in zip(self._stated, self.readback[: 5 + self._has_points], strict=False)
        ]
        start_hz, stop_hz, rbw_hz, vbw_hz, time_s = stated[:5]
        points = stated[5] if self._has_points else float(self._dialect.fixed_points or sweep.points)
        if not (stop_hz > start_hz and rbw_hz > 0.0 and vbw_hz > 0.0 and time_s > 0.0 and 1.0 < points < math.inf):
            message = f"settings {self._stated[:6]} make no sweep"
            raise scpi.AnswerError(message)
        return SweepSettings(
            start_hz,
            stop_hz,
            int(points),
            rbw_hz,
            rbw_hz * self._enbw_ratio,
            vbw_hz,
            time_s,
            sweep.detector,
            sweep.count,
        )

    def _wanted(self, sweep: SweepPart, path: InputPart) -> dict[str, str]:
        """Return header and value of every setting, in the order in which couplings want them."""
        start_hz, stop_hz = sweep.start_hz + path.freq_offset_hz, sweep.stop_hz + path.freq_offset_hz
        wanted = {
            ":FREQ:STAR": f"{start_hz:.3f}",
            ":FREQ:STOP": f"{stop_hz:.3f}",
            ":BAND": f"{sweep.rbw_hz:g}",
            ":BAND:VID": f"{10.0 * sweep.rbw_hz if sweep.vbw_hz is None else sweep.vbw_hz:g}",
        }
        wanted |= {self._dialect.points: str(sweep.points)} if self._has_points else {}
        wanted |= {":SWE:TIME:AUTO": "ON"} if sweep.time_s is None else {":SWE:TIME": f"{sweep.time_s:g}"}
        levels = self._level_settings(path)
        self._levels = list(levels)
        return wanted | levels

    def _level_settings(self, path: InputPart) -> dict[str, str]:
        """Return the settings of the input that the task names and the analyzer has."""
        levels = {}
        if path.ref_level_dbm is not None:
            levels[self._dialect.reference_level] = f"{path.ref_level_dbm:g}"
        if path.attenuation_db is not None:
            levels[self._dialect.attenuation] = f"{path.attenuation_db:g}"
        if path.preamp is not None and self._has_preamplifier(is_wanted=path.preamp):
            levels[self._dialect.preamplifier] = "ON" if path.preamp else "OFF"
        return levels

    def _has_preamplifier(self, *, is_wanted: bool) -> bool:
        """Return whether there is a preamplifier; one that is not there is off."""
        header = self._dialect.preamplifier
        if not is_wanted and header not in self._sent and header not in self._without:
            answer = self._dialogue.try_ask(f"{header}?")
            self._without |= set() if answer else {header}
        return is_wanted or header not in self._without

    def _differs(self, sweep: SweepPart, path: InputPart, actual: SweepSettings) -> bool:
        """Return whether the analyzer did not take span, points or time; its own RBW steps are no fault."""
        tolerance_hz = SETTING_TOLERANCE * (sweep.stop_hz - sweep.start_hz)
        is_start_off = abs(actual.start_hz - sweep.start_hz - path.freq_offset_hz) > tolerance_hz
        is_stop_off = abs(actual.stop_hz - sweep.stop_hz - path.freq_offset_hz) > tolerance_hz
        is_time_off = sweep.time_s is not None and abs(actual.sweep_time_s - sweep.time_s) > 0.1 * sweep.time_s
        is_rbw_off = not 0.5 < actual.rbw_hz / sweep.rbw_hz < 2.0
        is_points_off = actual.points not in {sweep.points, self._dialect.fixed_points}
        return is_start_off or is_stop_off or is_time_off or is_rbw_off or is_points_off

    def _require_words(self) -> None:
        """Raise when a word without which levels are wrong does not stand."""
        reported = dict(zip(self.readback, self._stated, strict=True))
        wrong = [word for word in self._words if word.is_needed and not word.stands(reported[f"{word.header}?"])]
        if wrong:
            said = ", ".join(f"{word.header} {reported[f'{word.header}?'][:20]!r}" for word in wrong)
            raise SweepRefusedError(f"{self._dialogue.session.resource} stays with {said}")


def _level_stands(answer: str, wanted: str) -> bool:
    """Return whether a setting of the input was taken."""
    if wanted in {"ON", "OFF"}:
        return scpi.parse_flag(answer) == (wanted == "ON")
    return abs(scpi.parse_number(answer) - float(wanted)) <= LEVEL_TOLERANCE_DB


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
        answers = scpi.split_answers(line)
        if not self._dialogue.is_joining:
            answers += self._dialogue.ask(further)
        if len(answers) != 1 + len(further):
            if scpi.is_message(answers[-1]):
                self._dialogue.raise_on_errors("the trace", scpi.parse_message(answers[-1]))
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
        wanted = self._configuration.format
        if isinstance(trace, str) or not wanted.is_binary:
            return self._of_text(trace if isinstance(trace, str) else trace.decode("ascii"), points)
        if len(trace) == 8 * points or len(trace) % 4:
            # Doubles, or something that is no floats at all: the analyzer did not mean the format that it took.
            return self._again_as_text(points)
        return scpi.levels_of_block(trace, points, is_big_endian=wanted.is_big_endian)

    def _again_as_text(self, points: int) -> FloatArray:
        """Ask for the same trace as text, from now on."""
        self._configuration.read_text()
        payload, line = self._dialogue.session.query_block(self._dialect.trace_query)
        return self._of_text(line if payload is None else payload.decode("ascii"), points)

    def _of_text(self, text: str, points: int) -> FloatArray:
        """Return the levels of text; its own number of them where the analyzer states none, or a wrong one as known."""
        own = len(text.strip().strip(",").split(","))
        is_own = own == self._dialect.fixed_points or (not self._configuration.has_points and own >= FEWEST_POINTS)
        return scpi.levels_of_text(text, own if is_own else points)


def _require_dbm(levels: FloatArray) -> None:
    """Raise when a trace cannot be in dBm, whatever unit the analyzer says."""
    present = levels[np.isfinite(levels)]
    if present.size and (present.max() > _MOST_DBM or np.abs(present).max() < _FLAT_DB):
        message = f"levels from {present.min():g} to {present.max():g} are not in dBm"
        raise scpi.AnswerError(message)


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
        identity: scpi.Identity,
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
    def analyzer_messages(self) -> list[scpi.AnalyzerMessage]:
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
        self._dialogue.raise_on_errors(f"sweep {sweep_id}", scpi.parse_message(answers.pop()))
        stated = [answers.pop() for _ in readback][::-1]
        is_unchanged = self._configuration.is_unchanged(stated)
        condition = int(scpi.parse_number(answers.pop(0), ":STAT:QUES:COND?")) if self.features.has_status else 0
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
        previous_trace, previous_us = self._previous.get(sweep_id, (b"", 0))
        self._previous[sweep_id] = (trace, epoch_us)
        return previous_trace == trace and (previous_us == epoch_us or not self._use_analyzer_clock)

    def _epoch_us(self, answers: list[str], settings: SweepSettings, system_us: int) -> int:
        """Return the middle of the dwell by the clock in use."""
        if not self._use_analyzer_clock:
            return system_us
        if self.features.has_dwell_epoch:
            return parse_epoch(answers[0].strip("\"'"))
        end_us = parse_epoch(scpi.parse_date_time(answers[0], answers[1]))
        return end_us - round(settings.sweep_time_s * US_PER_S / 2)
