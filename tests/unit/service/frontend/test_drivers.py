"""Drivers: answers of analyzers, sweeps with their epochs and traces, and who else turns the knobs."""

import struct

import numpy as np
import pytest
from scripted_analyzer import ScriptedSession

from service.frontend.drivers.dialects import RS, SIGLENT, Dialect, SweepRefusedError
from service.frontend.drivers.scpi import (
    AnalyzerMessage,
    AnswerError,
    Identity,
    block_length,
    levels_of_block,
    levels_of_text,
    parse_date_time,
    parse_flag,
    parse_identity,
    parse_message,
    parse_number,
    split_answers,
    split_block,
)
from service.frontend.drivers.scpi_driver import ScpiDriver
from service.frontend.drivers.visa_session import AnalyzerIOError
from service.frontend.measurement_task import InputPart, SweepPart


def test_a_block_may_hold_line_feeds() -> None:
    values = np.full(64, np.frombuffer(b"\n\n\n\n", dtype="<f4")[0])
    payload = values.astype("<f4").tobytes()
    header = b"#3256"
    assert split_block(header + payload + b';0,"No error"') == (payload, b';0,"No error"')


@pytest.mark.parametrize(
    "data",
    [b"", b"#", b"#x", b"#1", b"#24", b"#29\n", b"#15abcd", b"#2x1a", b"#9123", b"#(12", b"#(9)ab", b"1,2"],
)
def test_a_block_that_does_not_fit_is_refused(data: bytes) -> None:
    with pytest.raises(AnswerError):
        split_block(data)


def test_large_and_indefinite_blocks() -> None:
    assert split_block(b"#(3)abc;1") == (b"abc", b";1")
    assert split_block(b"#0abc\n") == (b"abc", b"")
    assert block_length(b"#4") == 4


def test_byte_order_of_a_real_trace() -> None:
    little = struct.pack("<3f", -42.5, 9.91e37, -999.0)
    levels = levels_of_block(little, 3)
    assert levels[0] == pytest.approx(-42.5, abs=0.0)  # representable in float32
    assert np.isnan(levels[1:]).all()
    big = levels_of_block(struct.pack(">1f", -42.5), 1, is_big_endian=True)
    assert big[0] == pytest.approx(-42.5, abs=0.0)


def test_a_trace_of_another_length_is_refused() -> None:
    with pytest.raises(AnswerError, match="3 points"):
        levels_of_block(b"\0" * 8, 3)
    with pytest.raises(AnswerError, match="2 values where 3"):
        levels_of_text("1,2", 3)


@pytest.mark.parametrize("text", ["-1.0,-2.5E+01", "-1.0,-2.5E+01,", "#A213-1.0,-2.5E+01\r\n", " -1.0 , -25 "])
def test_ascii_traces_of_several_makers(text: str) -> None:
    np.testing.assert_allclose(levels_of_text(text, 2), [-1.0, -25.0], atol=0.0)  # short decimals, exact in float64


def test_garbage_in_an_ascii_trace_is_refused() -> None:
    with pytest.raises(AnswerError, match="not a number"):
        levels_of_text("1,two", 2)


def test_messages_of_the_error_queue() -> None:
    assert parse_message('+0,"No error"').code == 0
    assert parse_message('-113,"Undefined ""header"";X"') == AnalyzerMessage(-113, 'Undefined "header";X')
    assert parse_message("-222,out of range").text == "out of range"
    with pytest.raises(AnswerError):
        parse_message("no error")


@pytest.mark.parametrize(
    ("code", "is_execution", "is_command"),
    [(-200, True, False), (-222, False, False), (-113, False, True), (-350, False, False), (-410, False, True)],
)
def test_which_messages_refuse(code: int, is_execution: bool, is_command: bool) -> None:
    message = AnalyzerMessage(code, "")
    assert (message.is_execution_error, message.is_command_error) == (is_execution, is_command)


def test_answers_are_cut_outside_quotes() -> None:
    assert split_answers('"a;b";2;') == ['"a;b"', "2", ""]


def test_numbers_and_flags() -> None:
    assert parse_number("9.91E37") != parse_number("9.91E37")  # NaN is not itself
    assert parse_flag("ON")
    assert not parse_flag("0")
    with pytest.raises(AnswerError):
        parse_number("fast")
    with pytest.raises(AnswerError):
        parse_flag("maybe")


def test_identity_of_four_and_of_more_fields() -> None:
    identity = parse_identity("Siglent Technologies,SSA3032X,SSA3X1,1.2.9.3,extra\n")
    assert (identity.vendor, identity.firmware) == ("Siglent Technologies", "1.2.9.3,extra")
    assert parse_identity("Maker,Model").serial == ""
    with pytest.raises(AnswerError):
        parse_identity("1")


def test_date_and_time() -> None:
    assert parse_date_time("2026,1,2", "3,4,5.25") == "2026-01-02T03:04:05.25Z"
    with pytest.raises(AnswerError):
        parse_date_time("today", "3,4,5")


SWEEP = SweepPart(id="tp1", start_hz=950e6, stop_hz=990e6, rbw_hz=40e3, points=11, time_s=2.0)


def driver(session: ScriptedSession, dialect: Dialect = RS, *, use_analyzer_clock: bool = False) -> ScpiDriver:
    """Return a driver that was preset and configured."""
    clock = iter(range(1_000_000, 2_000_000, 1000))
    made = ScpiDriver(
        session,  # type: ignore[arg-type]
        Identity("Rohde&Schwarz", "FSW-26", "1", "5"),
        dialect,
        lambda: next(clock),
        use_analyzer_clock=use_analyzer_clock,
        io_timeout_s=5.0,
    )
    made.preset()
    made.configure(SWEEP, InputPart())
    return made


@pytest.fixture
def session() -> ScriptedSession:
    return ScriptedSession()


@pytest.fixture
def made(session: ScriptedSession) -> ScpiDriver:
    """Give a driver of the session."""
    return driver(session)


def level_dbm(power_mw: np.ndarray, position: int = 0) -> float:
    return float(10 * np.log10(power_mw[position]))


def test_a_sweep_gives_milliwatts_and_the_analyzers_own_settings() -> None:
    session = ScriptedSession()
    session.stuck[":BAND"] = "5E4"
    sweep = driver(session).measure(SWEEP)
    # float32 of -90 and -80 dBm
    np.testing.assert_allclose(10 * np.log10(sweep.power_mw[[0, -1]]), [-90.0, -80.0], atol=1e-5)
    assert sweep.settings.rbw_hz == 5e4
    assert sweep.settings.enbw_hz == pytest.approx(1.0645 * 5e4, rel=1e-4)  # four printed digits
    assert not sweep.is_setting_mismatch


def test_the_sweep_is_awaited_for_one_and_a_half_sweep_times() -> None:
    session = ScriptedSession()
    driver(session).measure(SWEEP)
    assert session.timeouts[-1] == pytest.approx(1.5 * 2.0 + 5.0)  # the rule itself


def test_a_refused_sweep_gives_no_trace(session: ScriptedSession, made: ScpiDriver) -> None:
    session.queue += ['-200,"Execution error;end of scenario"', '-222,"Data out of range"']
    with pytest.raises(SweepRefusedError, match="end of scenario"):
        made.measure(SWEEP)
    assert session.queue == []


def test_a_clamped_setting_is_a_remark(session: ScriptedSession, made: ScpiDriver) -> None:
    made.analyzer_messages.clear()
    session.queue.append('-222,"Data out of range"')
    made.measure(SWEEP)
    assert [remark.code for remark in made.analyzer_messages] == [-222]


def test_status_bits() -> None:
    session = ScriptedSession()
    session.known[":STAT:QUES:COND?"] = str((1 << 3) | (1 << 5) | (1 << 8))
    sweep = driver(session).measure(SWEEP)
    assert (sweep.is_overrange, sweep.is_uncalibrated, sweep.is_reference_unlocked) == (True, True, True)


def test_epoch_of_the_system_is_the_middle_between_start_and_end() -> None:
    assert driver(ScriptedSession()).measure(SWEEP).epoch_us == 1_000_500


def test_epoch_of_a_simulator_is_its_dwell() -> None:
    sweep = driver(ScriptedSession(), use_analyzer_clock=True).measure(SWEEP)
    assert sweep.epoch_us == 1_795_230_152_011_250


def test_epoch_of_an_analyzer_with_a_calendar_is_half_a_sweep_back() -> None:
    session = ScriptedSession()
    session.known = {":SYST:DATE?": "2026,11,21", ":SYST:TIME?": "3,2,33"}
    sweep = driver(session, use_analyzer_clock=True).measure(SWEEP)
    assert sweep.epoch_us == 1_795_230_152_000_000


def test_an_analyzer_without_a_clock_cannot_stamp() -> None:
    session = ScriptedSession()
    session.known = {}
    with pytest.raises(SweepRefusedError, match="no clock"):
        driver(session, use_analyzer_clock=True)


def test_a_repeated_trace_is_stale_and_a_new_one_is_not(session: ScriptedSession, made: ScpiDriver) -> None:
    assert [made.measure(SWEEP).is_stale, made.measure(SWEEP).is_stale] == [False, True]
    session.levels = session.levels + 0.1
    assert not made.measure(SWEEP).is_stale


def test_count_averages_milliwatts(made: ScpiDriver) -> None:
    many = SWEEP.model_copy(update={"count": 3})
    made.configure(many, InputPart())
    assert level_dbm(made.measure(many).power_mw) == pytest.approx(-90.0, abs=1e-5)  # float32


def test_real_format_refused_means_text() -> None:
    session = ScriptedSession()
    session.stuck[":FORM"] = "ASC,0"
    assert level_dbm(driver(session).measure(SWEEP).power_mw) == pytest.approx(-90.0, abs=1e-5)
    assert ":FORM ASC" in session.reported


def test_a_block_of_doubles_falls_back_to_text() -> None:
    session = ScriptedSession()
    session.as_real = lambda levels: struct.pack(f"<{levels.size}d", *levels)
    made = driver(session)
    assert level_dbm(made.measure(SWEEP).power_mw) == pytest.approx(-90.0, abs=1e-5)
    assert level_dbm(made.measure(SWEEP).power_mw) == pytest.approx(-90.0, abs=1e-5)
    assert session.reported.count(":FORM ASC") == 1


def test_a_missing_answer_is_a_broken_session(session: ScriptedSession, made: ScpiDriver) -> None:
    del session.known[":STAT:QUES:COND?"]
    with pytest.raises(AnalyzerIOError, match="answers to"):
        made.measure(SWEEP)


class UnjoinedSession(ScriptedSession):
    """Session to an analyzer that answers every query of a message on a line of its own, or the last one alone."""

    def __init__(self, *, is_last_alone: bool) -> None:
        super().__init__()
        self.is_last_alone = is_last_alone
        self.lines: list[str] = []
        self.silent: set[str] = set()
        self.queries_of_messages = 0

    def write(self, message: str) -> None:
        units = message.split(";")
        queries = [unit for unit in units if unit.endswith("?")]
        super().write(";".join(unit for unit in units if unit not in queries) or "*WAI")
        self.queries_of_messages = max(len(queries), self.queries_of_messages)
        answers = [answer for query in queries if query not in self.silent for answer in self._answers(query)]
        self.lines += answers[-1:] if self.is_last_alone else answers

    def query(self, message: str, timeout_s: float | None = None) -> str:
        self.write(message)
        return self.read_line(message)

    def read_line(self, message: str) -> str:
        if not self.lines:
            error = f"{self.resource} does not answer {message!r}"
            raise AnalyzerIOError(error)
        return self.lines.pop(0)


@pytest.mark.parametrize("is_last_alone", [False, True])
def test_an_analyzer_that_does_not_join_answers_is_asked_one_by_one(*, is_last_alone: bool) -> None:
    unjoined = UnjoinedSession(is_last_alone=is_last_alone)
    one_by_one, joined = driver(unjoined, use_analyzer_clock=True), driver(ScriptedSession(), use_analyzer_clock=True)
    # the first message of a session finds it out
    assert unjoined.queries_of_messages == 2
    unjoined.queries_of_messages = 0
    sweep, wanted = one_by_one.measure(SWEEP), joined.measure(SWEEP)
    np.testing.assert_array_equal(sweep.power_mw, wanted.power_mw)
    assert (sweep.epoch_us, sweep.settings, one_by_one.features) == (wanted.epoch_us, wanted.settings, joined.features)
    assert (unjoined.queries_of_messages, unjoined.lines) == (1, [])


@pytest.mark.parametrize("is_last_alone", [False, True])
def test_the_fault_names_the_query_that_is_not_answered(*, is_last_alone: bool) -> None:
    unjoined = UnjoinedSession(is_last_alone=is_last_alone)
    made = driver(unjoined)
    unjoined.silent = {":SWE:TIME?"}
    with pytest.raises(AnalyzerIOError, match=r"does not answer ':SWE:TIME\?'"):
        made.measure(SWEEP)
    unjoined = UnjoinedSession(is_last_alone=is_last_alone)
    unjoined.stuck[":BAND"] = "fast"
    with pytest.raises(AnswerError, match=r":BAND\? answered 'fast', which is not a number"):
        driver(unjoined)


def test_error_codes_without_a_text(session: ScriptedSession, made: ScpiDriver) -> None:
    assert (parse_message(" -222 "), parse_message("0").code) == (AnalyzerMessage(-222, ""), 0)
    session.answer = lambda query: "0" if query == ":SYST:ERR?" else None
    assert np.isfinite(made.measure(SWEEP).power_mw).all()
    session.answer = lambda query: "-200" if query == ":SYST:ERR?" else None
    with pytest.raises(AnalyzerIOError, match="error queue without end"):
        made.measure(SWEEP)


def test_an_endless_error_queue_is_a_broken_session(session: ScriptedSession, made: ScpiDriver) -> None:
    session.queue += ['-222,"again"'] * 500
    with pytest.raises(AnalyzerIOError, match="without end"):
        made.measure(SWEEP)


@pytest.mark.parametrize("header", [":FREQ:STAR", ":BAND", ":SWE:POIN", ":UNIT:POW", ":DET", ":DISP:TRAC:MODE"])
def test_a_setting_changed_during_a_sweep_is_restored_and_the_sweep_taken_again(
    session: ScriptedSession, made: ScpiDriver, header: str
) -> None:
    before = session.values[header]

    def change() -> None:
        session.values[header] = {":UNIT:POW": "V", ":DET": "POS", ":DISP:TRAC:MODE": "MAXH"}.get(header, "1E3")
        session.after_sweep = lambda: None

    session.after_sweep = change
    sweep = made.measure(SWEEP)
    assert made.foreign_changes == 1
    assert session.values[header] == before
    assert sweep.is_setting_mismatch
    assert level_dbm(sweep.power_mw) == pytest.approx(-90.0, abs=1e-5)
    session.levels = session.levels + 0.1
    assert not made.measure(SWEEP).is_setting_mismatch


@pytest.mark.parametrize("header", [":BAND:VID", ":BAND", ":INP:ATT", ":UNIT:POW", ":INIT:CONT", ":FORM"])
def test_a_setting_changed_between_two_sweeps_is_restored_before_the_next_of_its_kind(
    session: ScriptedSession, made: ScpiDriver, header: str
) -> None:
    path = InputPart(attenuation_db=10.0)
    other = SWEEP.model_copy(update={"id": "tp2", "start_hz": 960e6})
    for sweep in (SWEEP, other):
        made.configure(sweep, path)
    before = session.values[header]
    session.values[header] = {":UNIT:POW": "V", ":FORM": "ASC,0", ":INIT:CONT": "1"}.get(header, "12E3")
    made.configure(SWEEP, path)
    assert made.foreign_changes == 1
    assert session.values[header] == before
    made.configure(other, path)
    assert made.foreign_changes == 1


def test_a_sweep_whose_settings_never_stand_still_is_no_measurement(session: ScriptedSession, made: ScpiDriver) -> None:
    turns = iter(range(100))

    def turn() -> None:
        session.values[":BAND:VID"] = f"{next(turns)}E3"

    session.after_sweep = turn
    sweep = made.measure(SWEEP)
    assert np.isnan(sweep.power_mw).all()
    assert sweep.is_setting_mismatch


def test_another_unit_that_stays_is_refused(session: ScriptedSession, made: ScpiDriver) -> None:
    session.stuck[":UNIT:POW"] = "V"
    session.values[":UNIT:POW"] = "V"
    with pytest.raises(SweepRefusedError, match="UNIT:POW 'V'"):
        made.measure(SWEEP)


@pytest.mark.parametrize("answer", ["", "#0", "1,2,3", "NAN" * 3, ",".join(["x"] * 11)])
def test_what_is_no_trace_is_never_a_level(answer: str) -> None:
    session = ScriptedSession("siglent")
    made = driver(session, SIGLENT)
    session.query_block = lambda *_: (None, answer + _rest(session, made))  # type: ignore[method-assign]
    with pytest.raises((SweepRefusedError, AnalyzerIOError, ValueError)):
        made.measure(SWEEP)


@pytest.mark.parametrize("unit", ["dBuV", "W", "V"])
def test_levels_in_another_unit_than_stated_are_not_levels(
    session: ScriptedSession, made: ScpiDriver, unit: str
) -> None:
    convert = {
        "dBuV": lambda dbm: dbm + 130.0,
        "W": lambda dbm: 10 ** (dbm / 10 - 3),
        "V": lambda dbm: 10 ** (dbm / 20),
    }
    session.levels = convert[unit](session.levels)
    with pytest.raises(ValueError, match="not in dBm"):
        made.measure(SWEEP)


def test_a_trace_that_reaches_the_reference_level_is_overdriven(session: ScriptedSession, made: ScpiDriver) -> None:
    made.configure(SWEEP, InputPart(ref_level_dbm=-80.0))
    assert made.measure(SWEEP).is_overrange
    made.configure(SWEEP, InputPart(ref_level_dbm=-79.0))
    session.levels = session.levels - 0.1
    assert not made.measure(SWEEP).is_overrange


@pytest.mark.parametrize("code", ["-999.0", "9.91E37", "9.9E37", "-9.9E37", "NAN", "INF"])
def test_codes_for_no_number_are_not_levels(code: str) -> None:
    session = ScriptedSession("siglent")
    made = driver(session, SIGLENT)
    text = ",".join([code] * 751) + ","
    session.query_block = lambda *_: (None, text + _rest(session, made))  # type: ignore[method-assign]
    assert np.isnan(made.measure(SWEEP).power_mw).all()


def _rest(session: ScriptedSession, made: ScpiDriver) -> str:
    """Return what follows a trace: status, settings, error queue."""
    queries = [":STAT:QUES:COND?", *made._configuration.readback, ":SYST:ERR?"]
    return "".join(f";{answer}" for answer in session._answers(";".join(queries)))
