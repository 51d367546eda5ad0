"""The driver against a scripted session."""

import struct
from collections.abc import Callable

import numpy as np
import pytest

from service.frontend.drivers.base import Dialect, SweepRefusedError
from service.frontend.drivers.choice import dialect_of, identify
from service.frontend.drivers.generic import GENERIC
from service.frontend.drivers.rs import RS
from service.frontend.drivers.scpi_driver import ScpiDriver
from service.frontend.measurement_task import InputPart, SweepPart
from service.frontend.scpi import Identity
from service.frontend.visa_session import AnalyzerIOError

SWEEP = SweepPart(id="tp1", start_hz=950e6, stop_hz=990e6, rbw_hz=40e3, points=11, time_s=2.0)
IDENTITY = Identity("Rohde&Schwarz", "FSW-26", "1", "5")


class ScriptedSession:
    """Analyzer of eleven points that keeps what it is told."""

    resource = "TCPIP::analyzer::5025::SOCKET"

    def __init__(self) -> None:
        self.told: list[str] = []
        self.queue: list[str] = []
        self.values = {"STAR": "950e6", "STOP": "990e6", "BAND": "4E4", "VID": "4E5", "POIN": "11", "TIME": "2.0"}
        self.known = {":STAT:QUES:COND?": "0", ":SIM:EPOCH?": "2026-11-21T03:02:32.011250Z"}
        self.levels = np.linspace(-90.0, -80.0, 11)
        self.knows_real = True
        self.is_closed = False
        self.timeouts: list[float | None] = []
        self.as_real: Callable[[np.ndarray], bytes] = lambda levels: levels.astype("<f4").tobytes()

    def close(self) -> None:
        self.is_closed = True

    def write(self, message: str) -> None:
        self.told.append(message)
        if message.startswith(":FORM REAL") and not self.knows_real:
            self.queue.append('-141,"Invalid character data"')

    def query(self, message: str, timeout_s: float | None = None) -> str:
        self.told.append(message)
        self.timeouts.append(timeout_s)
        if message == "*IDN?":
            return ",".join(IDENTITY)
        return ";".join(self._answers(message))

    def await_answer(self, message: str, timeout_s: float, grace_s: float) -> str:
        assert grace_s <= timeout_s
        return self.query(message, timeout_s)

    def query_block(self, message: str, timeout_s: float | None = None) -> tuple[bytes | None, str]:
        self.told.append(message)
        rest = ";".join(self._answers(message.split(";", 1)[1]))
        if any(told.startswith(":FORM ASC") for told in self.told):
            return None, ",".join(f"{level:.6E}" for level in self.levels) + ";" + rest
        return self.as_real(self.levels), ";" + rest

    def _answers(self, message: str) -> list[str]:
        answers = []
        for unit in message.split(";"):
            header = unit if unit.startswith((":", "*")) else f":{unit}"
            short = header.rstrip("?").rsplit(":", 1)[-1]
            if header == ":INIT":
                continue
            if header == "*OPC?":
                answers.append("1")
            elif header == ":SYST:ERR?":
                answers.append(self.queue.pop(0) if self.queue else '0,"No error"')
            elif header in self.known:
                answers.append(self.known[header])
            elif short in self.values:
                answers.append(self.values[short])
            elif header.startswith(":TRAC"):
                answers.append(",".join(f"{level:.6E}" for level in self.levels))
            else:
                self.queue.append('-113,"Undefined header"')
                break
        return answers


def driver(session: ScriptedSession, dialect: Dialect = RS, *, use_analyzer_clock: bool = False) -> ScpiDriver:
    """Return a driver that was preset and configured."""
    clock = iter(range(1_000_000, 2_000_000, 1000))
    made = ScpiDriver(
        session,  # type: ignore[arg-type]
        IDENTITY,
        dialect,
        lambda: next(clock),
        use_analyzer_clock=use_analyzer_clock,
        io_timeout_s=5.0,
    )
    made.preset()
    made.configure(SWEEP, InputPart())
    return made


def test_a_sweep_gives_milliwatts_and_the_analyzers_own_settings() -> None:
    session = ScriptedSession()
    session.values["BAND"] = "5E4"
    sweep = driver(session).take(SWEEP)
    # float32 of -90 and -80 dBm
    np.testing.assert_allclose(10 * np.log10(sweep.power_mw[[0, -1]]), [-90.0, -80.0], atol=1e-5)
    assert sweep.settings.rbw_hz == 5e4
    assert sweep.settings.enbw_hz == pytest.approx(1.0645 * 5e4, rel=1e-4)  # four printed digits
    assert not sweep.is_setting_mismatch


def test_the_sweep_is_awaited_for_one_and_a_half_sweep_times() -> None:
    session = ScriptedSession()
    driver(session).take(SWEEP)
    assert session.timeouts[-1] == pytest.approx(1.5 * 2.0 + 5.0)  # the rule itself


def test_only_changed_settings_are_sent_again() -> None:
    session = ScriptedSession()
    made = driver(session)
    session.told.clear()
    made.configure(SWEEP, InputPart())
    assert not any("FREQ:STAR " in told for told in session.told)
    made.configure(SWEEP.model_copy(update={"rbw_hz": 30e3}), InputPart(ref_level_dbm=-30.0, attenuation_db=10.0))
    assert ":BAND 30000;:BAND:VID 300000;:DISP:TRAC:Y:RLEV -30;:INP:ATT 10" in session.told


def test_coupled_time_is_not_taken_for_a_time_sent_before() -> None:
    session = ScriptedSession()
    made = driver(session)
    made.configure(SWEEP.model_copy(update={"time_s": None}), InputPart())
    session.told.clear()
    made.configure(SWEEP, InputPart())
    assert any(":SWE:TIME 2" in told for told in session.told)


def test_other_points_than_asked_for_are_flagged() -> None:
    session = ScriptedSession()
    session.values["POIN"] = "751"
    session.levels = np.full(751, -90.0)
    assert driver(session).take(SWEEP).is_setting_mismatch


def test_settings_changed_by_somebody_else_are_sent_again() -> None:
    session = ScriptedSession()
    made = driver(session)
    session.told.clear()
    session.values["STAR"] = "900e6"
    made.configure(SWEEP, InputPart())
    assert sum(":FREQ:STAR 950000000.000" in told for told in session.told) == 1


def test_a_refused_sweep_gives_no_trace() -> None:
    session = ScriptedSession()
    made = driver(session)
    session.queue += ['-200,"Execution error;end of scenario"', '-222,"Data out of range"']
    with pytest.raises(SweepRefusedError, match="end of scenario"):
        made.take(SWEEP)
    assert session.queue == []


def test_a_clamped_setting_is_a_remark() -> None:
    session = ScriptedSession()
    made = driver(session)
    session.queue.append('-222,"Data out of range"')
    made.take(SWEEP)
    assert [remark.code for remark in made.remarks] == [-222]


def test_status_bits() -> None:
    session = ScriptedSession()
    session.known[":STAT:QUES:COND?"] = str((1 << 3) | (1 << 5) | (1 << 8))
    sweep = driver(session).take(SWEEP)
    assert (sweep.is_overrange, sweep.is_uncalibrated, sweep.is_reference_unlocked) == (True, True, True)


def test_epoch_of_the_system_is_the_middle_between_start_and_end() -> None:
    assert driver(ScriptedSession()).take(SWEEP).epoch_us == 1_000_500


def test_epoch_of_a_simulator_is_its_dwell() -> None:
    sweep = driver(ScriptedSession(), use_analyzer_clock=True).take(SWEEP)
    assert sweep.epoch_us == 1_795_230_152_011_250


def test_epoch_of_an_analyzer_with_a_calendar_is_half_a_sweep_back() -> None:
    session = ScriptedSession()
    session.known = {":SYST:DATE?": "2026,11,21", ":SYST:TIME?": "3,2,33"}
    sweep = driver(session, use_analyzer_clock=True).take(SWEEP)
    assert sweep.epoch_us == 1_795_230_152_000_000


def test_an_analyzer_without_a_clock_cannot_stamp() -> None:
    session = ScriptedSession()
    session.known = {}
    with pytest.raises(SweepRefusedError, match="no clock"):
        driver(session, use_analyzer_clock=True)


def test_a_repeated_trace_is_stale_and_a_new_one_is_not() -> None:
    session = ScriptedSession()
    made = driver(session)
    assert [made.take(SWEEP).is_stale, made.take(SWEEP).is_stale] == [False, True]
    session.levels = session.levels + 0.1
    assert not made.take(SWEEP).is_stale


def test_count_averages_milliwatts() -> None:
    session = ScriptedSession()
    made = driver(session)
    many = SWEEP.model_copy(update={"count": 3})
    made.configure(many, InputPart())
    assert 10 * np.log10(made.take(many).power_mw[0]) == pytest.approx(-90.0, abs=1e-5)  # float32


def test_real_format_refused_means_ascii() -> None:
    session = ScriptedSession()
    session.knows_real = False
    assert 10 * np.log10(driver(session).take(SWEEP).power_mw[0]) == pytest.approx(-90.0, abs=1e-5)
    assert ":FORM ASC" in session.told


def test_a_block_of_doubles_falls_back_to_ascii() -> None:
    session = ScriptedSession()
    session.as_real = lambda levels: struct.pack(f"<{levels.size}d", *levels)
    made = driver(session)
    assert 10 * np.log10(made.take(SWEEP).power_mw[0]) == pytest.approx(-90.0, abs=1e-5)
    assert 10 * np.log10(made.take(SWEEP).power_mw[0]) == pytest.approx(-90.0, abs=1e-5)
    assert session.told.count(":FORM ASC") == 1


def test_a_generic_analyzer_is_read_as_ascii() -> None:
    session = ScriptedSession()
    sweep = driver(session, GENERIC).take(SWEEP)
    assert 10 * np.log10(sweep.power_mw[-1]) == pytest.approx(-80.0, abs=1e-5)  # seven printed digits
    assert not any("REAL" in told for told in session.told)


def test_a_missing_answer_is_a_broken_session() -> None:
    session = ScriptedSession()
    made = driver(session)
    del session.known[":STAT:QUES:COND?"]
    with pytest.raises(AnalyzerIOError, match="answers to"):
        made.take(SWEEP)


def test_an_endless_error_queue_is_a_broken_session() -> None:
    session = ScriptedSession()
    made = driver(session)
    session.queue += ['-222,"again"'] * 500
    with pytest.raises(AnalyzerIOError, match="without end"):
        made.take(SWEEP)


def test_who_speaks_which_dialect() -> None:
    assert dialect_of(IDENTITY) is RS
    assert dialect_of(Identity("Keysight Technologies", "N9020B", "", "")) is GENERIC
    assert dialect_of(IDENTITY, "generic") is GENERIC
    with pytest.raises(ValueError, match="no dialect"):
        dialect_of(IDENTITY, "morse")
    session = ScriptedSession()
    assert identify(session).model == "FSW-26"  # type: ignore[arg-type]
