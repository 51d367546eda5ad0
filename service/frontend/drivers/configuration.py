"""Settings of one analyzer: sent when they differ, read back always, restored when somebody else changed them.

Law of this file: what the analyzer states counts, not what it was told. A setting without which levels are wrong (unit,
detector, kind of average, trace that holds no maximum) either stands or the sweep is refused; any other value that the
analyzer chooses is used as it is and flagged.
"""

import math

from service.frontend.drivers.dialects import ASCII, SINGLE, Dialect, SweepRefusedError, TraceFormat, Word
from service.frontend.drivers.dialogue import Dialogue
from service.frontend.drivers.scpi import AnswerError, parse_flag, parse_message, parse_number
from service.frontend.measurement_task import InputPart, SweepPart
from service.records.levels.sweep import SweepSettings

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
        self._dialogue.raise_on_errors("settings", parse_message(newest))
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
            parse_number(*pair) for pair in zip(self._stated, self.readback[: 5 + self._has_points], strict=False)
        ]
        start_hz, stop_hz, rbw_hz, vbw_hz, time_s = stated[:5]
        points = stated[5] if self._has_points else float(self._dialect.fixed_points or sweep.points)
        if not (stop_hz > start_hz and rbw_hz > 0.0 and vbw_hz > 0.0 and time_s > 0.0 and 1.0 < points < math.inf):
            message = f"settings {self._stated[:6]} make no sweep"
            raise AnswerError(message)
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
        return parse_flag(answer) == (wanted == "ON")
    return abs(parse_number(answer) - float(wanted)) <= LEVEL_TOLERANCE_DB
