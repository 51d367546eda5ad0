"""Commands of each dialect, its traces, and the recognition of a maker."""

import numpy as np
import pytest
from scripted_analyzer import FAMILIES, ScriptedSession

from service.frontend.drivers.dialects import DIALECTS, SweepRefusedError, dialect_of, identify
from service.frontend.drivers.scpi import Identity, parse_identity
from service.frontend.drivers.scpi_driver import ScpiDriver
from service.frontend.measurement_task import AnalyzerPart, InputPart, SweepPart

SWEEP = SweepPart(id="tp1", start_hz=950e6, stop_hz=990e6, rbw_hz=40e3, points=11, time_s=2.0)
PATH = InputPart(ref_level_dbm=-30.0, attenuation_db=10.0, preamp=False)
BY_NAME = {dialect.name: dialect for dialect in DIALECTS}


def driver(session: ScriptedSession, name: str) -> ScpiDriver:
    """Return a driver that was preset."""
    made = ScpiDriver(session, parse_identity(session.identity), BY_NAME[name], lambda: 0)  # type: ignore[arg-type]
    made.preset()
    return made


@pytest.mark.parametrize("name", list(FAMILIES))
def test_a_trace_of_every_family_is_read_in_dbm(name: str) -> None:
    session = ScriptedSession(name)
    made = driver(session, name)
    made.configure(SWEEP, PATH)
    sweep = made.measure(SWEEP)
    # float32 and seven printed digits
    np.testing.assert_allclose(10 * np.log10(sweep.power_mw), session.levels, atol=1e-5)
    assert not sweep.is_setting_mismatch
    assert made.foreign_changes == 0


@pytest.mark.parametrize(
    ("name", "sent"),
    [
        ("rs", [":UNIT:POW DBM", ":DET RMS", ":DISP:TRAC:MODE WRIT", ":FORM REAL,32", ":SWE:TYPE SWE"]),
        (
            "keysight",
            [
                ":UNIT:POW DBM",
                ":DET:TRAC AVER",
                ":AVER:TYPE RMS",
                ":TRAC:TYPE WRIT",
                ":FORM:BORD NORM",
                ":FORM REAL,32",
            ],
        ),
        ("siglent", [":UNIT:POW DBM", ":DET:TRAC1 AVER", ":AVER:TYPE POW", ":TRAC1:MODE WRIT", ":FORM ASC"]),
        ("anritsu", [":UNIT:POW DBM", ":DET RMS", ":TRAC1:TYPE NORM", ":FORM ASC"]),
    ],
)
def test_nothing_that_makes_a_level_is_left_to_chance(name: str, sent: list[str]) -> None:
    session = ScriptedSession(name)
    driver(session, name)
    assert [each for each in sent if each not in session.reported] == []
    for each in sent:
        header, _, value = each.partition(" ")
        assert session.values[header] == value


@pytest.mark.parametrize(
    ("name", "sent"),
    [
        ("rs", ":DISP:TRAC:Y:RLEV -30;:INP:ATT 10;:INP:GAIN:STAT OFF"),
        ("keysight", ":DISP:WIND:TRAC:Y:RLEV -30;:POW:ATT 10;:POW:GAIN OFF"),
        ("siglent", ":DISP:WIND:TRAC:Y:RLEV -30;:POW:ATT 10;:POW:GAIN OFF"),
        ("anritsu", ":DISP:WIND:TRAC:Y:SCAL:RLEV -30;:POW:RF:ATT 10;:POW:RF:GAIN:STAT OFF"),
    ],
)
def test_settings_of_the_input(name: str, sent: str) -> None:
    session = ScriptedSession(name)
    driver(session, name).configure(SWEEP, PATH)
    assert any(reported.endswith(sent) for reported in session.reported)


@pytest.mark.parametrize("header", [":UNIT:POW", ":DET:TRAC", ":AVER:TYPE", ":TRAC:TYPE"])
def test_an_analyzer_that_keeps_a_wrong_method_is_refused(header: str) -> None:
    session = ScriptedSession("keysight")
    session.stuck[header] = "LOG"
    with pytest.raises(SweepRefusedError):
        driver(session, "keysight")


def test_a_family_without_a_preamplifier_has_it_off_and_cannot_have_it_on() -> None:
    session = ScriptedSession("rs")
    del session.values[":INP:GAIN:STAT"]
    made = driver(session, "rs")
    made.configure(SWEEP, PATH)
    with pytest.raises((SweepRefusedError, Exception), match=r"answers|refuses"):
        made.configure(SWEEP, PATH.model_copy(update={"preamp": True}))


def test_byte_order_is_what_was_stated() -> None:
    session = ScriptedSession("keysight")
    made = driver(session, "keysight")
    made.configure(SWEEP, PATH)
    assert session._byte_order == ">f4"
    assert 10 * np.log10(made.measure(SWEEP).power_mw[0]) == pytest.approx(-90.0, abs=1e-5)  # float32


def test_only_changed_settings_are_sent_again() -> None:
    session = ScriptedSession()
    made = driver(session, "rs")
    made.configure(SWEEP, InputPart())
    session.reported.clear()
    made.configure(SWEEP, InputPart())
    assert not any("FREQ:STAR " in reported for reported in session.reported)
    made.configure(SWEEP.model_copy(update={"rbw_hz": 30e3}), InputPart(ref_level_dbm=-30.0, attenuation_db=10.0))
    assert ":BAND 30000;:BAND:VID 300000;:DISP:TRAC:Y:RLEV -30;:INP:ATT 10" in session.reported


def test_coupled_time_is_not_taken_for_a_time_sent_before() -> None:
    session = ScriptedSession()
    made = driver(session, "rs")
    made.configure(SWEEP, InputPart())
    made.configure(SWEEP.model_copy(update={"time_s": None}), InputPart())
    session.reported.clear()
    made.configure(SWEEP, InputPart())
    assert any(":SWE:TIME 2" in reported for reported in session.reported)


def test_other_points_than_asked_for_are_used_and_flagged() -> None:
    session = ScriptedSession()
    session.stuck[":SWE:POIN"] = "751"
    session.levels = np.full(751, -90.0)
    made = driver(session, "rs")
    assert made.configure(SWEEP, InputPart()).points == 751
    sweep = made.measure(SWEEP)
    assert sweep.is_setting_mismatch
    assert sweep.power_mw.size == 751


@pytest.mark.parametrize("answers_points", [True, False])
def test_a_siglent_sweeps_751_points_whatever_it_says(answers_points: bool) -> None:
    session = ScriptedSession("siglent")
    if answers_points:
        session.values[":SWE:POIN"] = "11"
    session.levels = np.full(751, -90.0)
    made = driver(session, "siglent")
    made.configure(SWEEP, InputPart())
    sweep = made.measure(SWEEP)
    assert sweep.settings.points == sweep.power_mw.size == 751
    assert sweep.settings.step_hz == pytest.approx(40e6 / 750)


def test_a_siglent_is_asked_for_the_end_of_its_sweep() -> None:
    session = ScriptedSession("siglent")
    made = driver(session, "siglent")
    made.configure(SWEEP, InputPart())
    made.measure(SWEEP)
    assert not any("SWE:STAT" in reported for reported in session.reported[-2:])
    answers = iter(["1", "0", "0", "1", "1"])
    session.answer = lambda header: next(answers) if header.startswith(":TRAC:SWE:STAT") else None
    made.preset()
    made.configure(SWEEP, InputPart())
    session.reported.clear()
    made.measure(SWEEP)
    assert [reported for reported in session.reported if "SWE:STAT" in reported] == [":TRAC:SWE:STAT? 1"] * 3


def test_an_anritsu_without_a_trace_yet_says_so() -> None:
    session = ScriptedSession("anritsu")
    made = driver(session, "anritsu")
    made.configure(SWEEP, InputPart())
    further = [":STAT:QUES:COND?", *made._configuration.readback, ":SYST:ERR?"]
    session.query_block = lambda *_: (None, ";".join(["#0", *session._answers(";".join(further))]))  # type: ignore[method-assign]
    with pytest.raises(SweepRefusedError, match="no trace"):
        made.measure(SWEEP)


def test_a_generic_analyzer_is_asked_for_the_mean_of_powers_in_three_ways() -> None:
    session = ScriptedSession("anritsu")
    session.values |= {":AVER:TYPE": "LOG", ":DET": "NORM", ":SWE:POIN": "11"}
    session.stuck[":DET"] = "AVER"
    driver(session, "generic")
    assert session.values[":AVER:TYPE"] == "RMS"
    session.stuck[":DET"] = "POS"
    with pytest.raises(SweepRefusedError, match="mean of powers"):
        driver(session, "generic")


@pytest.mark.parametrize(
    ("identity", "name"),
    [
        ("Rohde&Schwarz,FSW-26,1331.5003K26/100001,5.30", "rs"),
        ("Rohde & Schwarz,FSV-7,1307.9002K07/100,3.20", "rs"),
        ("ROHDE&SCHWARZ,FSL-6,100123/006,1.90", "rs"),
        ("R&S,FPC1000,1,1", "rs"),
        ("Keysight Technologies,N9000B,MY57,A.30.05", "keysight"),
        ("Agilent Technologies,N9010A,MY51,A.14.16", "keysight"),
        ("Agilent Technologies, E4440A, MY4, A.11", "keysight"),
        ("Hewlett-Packard, E4408B, US4, A.08", "keysight"),
        ("Siglent Technologies,SSA3032X,SSA3X,1.2.9.3", "siglent"),
        ("Siglent,SVA1015X,SVA1,2.2", "siglent"),
        ("Teledyne Test Tools,T3SA3200,T3,1.3", "siglent"),
        ("Anritsu,MS2090A,1,V2023", "anritsu"),
        ('"Anritsu",MS2726C/31,1,3.4', "anritsu"),
        ("Rigol Technologies,DSA815,DSA8,00.01", "generic"),
        ("Tektronix,RSA5103B,B,3.9", "generic"),
    ],
)
def test_who_speaks_which_dialect(identity: str, name: str) -> None:
    assert dialect_of(parse_identity(identity)).name == name


def test_the_task_may_name_the_dialect() -> None:
    rigol = Identity("Rigol", "DSA815", "", "")
    for name in BY_NAME:
        assert dialect_of(rigol, name).name == name
        assert AnalyzerPart.model_validate({"dialect": name}).dialect == name
    with pytest.raises(ValueError, match="no dialect"):
        dialect_of(rigol, "morse")
    assert identify(ScriptedSession()).model == "FSW-26"  # type: ignore[arg-type]
