"""Every row of the table of commands (analyzer specification, section 1) is set and read back; its page is current."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from analyzer_sim.dialects.dialect_page import MARKDOWN_COMMAND, markdown_page
from analyzer_sim.dialects.dialects import DIALECTS
from analyzer_sim.lines.dispatcher import command_tree

ALL = ("rs", "keysight", "siglent", "anritsu")
ATTENUATION = {"rs": ":INP:ATT", "keysight": ":POW:ATT", "siglent": ":POW:ATT", "anritsu": ":POW:RF:ATT"}
REFERENCE = dict.fromkeys(ALL, ":DISP:WIND:TRAC:Y:SCAL:RLEV")
TABLE: tuple[tuple[str, str, str, tuple[str, ...]], ...] = (
    ("FREQ:CENT 1.017 GHZ", "FREQ:CENT?", "1017000000", ALL),
    ("FREQ:SPAN 20 MHZ", "FREQ:SPAN?", "20000000", ALL),
    ("FREQ:STAR 954 MHZ;STOP 990 MHZ", "FREQ:STAR?;STOP?", "954000000;990000000", ALL),
    ("FREQ:OFFS 1 GHZ", "FREQ:OFFS?", "1000000000", ALL),
    ("BAND 30 KHZ", "BAND?;:BWID:RES?;:BAND:AUTO?", "30000;30000;0", ALL),
    ("BWID:VID 300 KHZ", "BAND:VID?;VID:AUTO?", "300000;0", ALL),
    ("BAND:AUTO OFF;VID:AUTO OFF", "BAND:AUTO?;VID:AUTO?", "0;0", ALL),
    ("SENS:WIND1:FREQ:CENT 1 GHZ", "SENS:WIND1:FREQ:CENT?;:FREQ:CENT?", "1000000000;1000000000", ("rs",)),
    ("UNIT:POW WATT", "UNIT:POW?", "W", ("rs",)),
    ("SWE:TYPE FFT", "SWE:TYPE:USED?", "FFT", ("rs",)),
    (
        "FREQ:SPAN 20 MHZ;CENT:STEP 5 MHZ;STEP:AUTO ON",
        "FREQ:CENT:STEP?;STEP:AUTO?",
        "2000000;1",
        ("rs", "keysight", "siglent"),
    ),
    ("FREQ:SPAN 20 MHZ;:BAND:RAT 0.001", "BAND:RAT?;:BAND?", "0.001;20000", ("rs",)),
    ("FREQ:SPAN 30 MHZ;:BAND:RAT 0.001", "BAND:RAT?;:BAND?", "0.001;30000", ("anritsu",)),
    ("FREQ:SPAN 20 MHZ;SPAN:BAND:RAT 1000", "FREQ:SPAN:BAND:RAT?;:BAND?", "1000;20000", ("keysight",)),
    ("BAND 30 KHZ;:BAND:VID:RAT 10", "BAND:VID:RAT?;:BAND:VID?", "10;300000", ALL),
    ("FREQ:SPAN 20 MHZ;SPAN 2 MHZ;SPAN:PREV", "FREQ:SPAN?", "20000000", ("keysight", "siglent", "anritsu")),
    ("FREQ:SPAN 20 MHZ;SPAN 2 MHZ;SPAN:LAST", "FREQ:SPAN?", "20000000", ("anritsu",)),
    ("FREQ:SPAN 20 MHZ;SPAN:HALF;DOUB;DOUB", "FREQ:SPAN?", "40000000", ("siglent",)),
    ("DISP:FORM SPL", "DISP:FORM?", "SPL", ("rs",)),
    ("BAND:TYPE NOISE", "BAND:TYPE?", "NOIS", ("keysight",)),
    ("FILT:TYPE EMI", "FILT:TYPE?", "EMI", ("siglent",)),
    ("SWE:POIN 2001", "SWE:POIN?", "2001", ("rs", "keysight")),
    ("SENS:SWE:WIND2:POIN 2001", "SWE:POIN?", "2001", ("rs",)),
    ("SWE:POIN 2001", "SWE:POIN?", "751", ("siglent",)),
    ("DISP:POIN 2001", "DISP:POINTCOUNT?", "2001", ("anritsu",)),
    ("SWE:TIME 200 MS", "SWE:TIME?;TIME:AUTO?", "0.2;0", ALL),
    ("SWE:COUN 5", "SWE:COUN?", "5", ("rs", "siglent")),
    ("SWE:TYPE FFT", "SWE:TYPE?", "FFT", ("rs", "keysight")),
    ("SWE:OPT DYN", "SWE:OPT?", "DYN", ("rs",)),
    ("SWE:TYPE:AUTO OFF", "SWE:TYPE?;TYPE:AUTO?", "SWE;0", ("keysight",)),
    ("SWE:MODE FFT", "SWE:MODE?", "FFT", ("siglent",)),
    ("DET RMS", "DET?", "RMS", ("rs", "anritsu")),
    ("SENS:WIND:DET1:FUNC APE", "DET?", "APE", ("rs",)),
    ("DET QPE", "DET?", "QPE", ("rs",)),
    ("DET:TRAC AVER;:AVER:TYPE RMS", "DET:TRAC?;:AVER:TYPE?", "AVER;RMS", ("keysight",)),
    ("DET:TRAC1 AVER;:AVER:TYPE POW", "DET:TRAC1?;:AVER:TYPE?", "AVER;POW", ("siglent",)),
    ("DET:TRAC NORM", "DET:TRAC?", "NORM", ("keysight", "siglent")),
    ("DET:FUNC NEG", "DET?", "NEG", ("rs", "anritsu")),
    ("AVER:COUN 8;STAT ON;TYPE LIN", "AVER:COUN?;STAT?;TYPE?", "8;1;LIN", ("rs",)),
    ("DISP:TRAC:MODE AVER", "DISP:TRAC:MODE?", "AVER", ("rs",)),
    ("AVER:COUN 8;TYPE SCAL;:TRAC:TYPE AVER", "AVER:COUN?;TYPE?;:TRAC1:TYPE?", "8;SCAL;AVER", ("keysight",)),
    (
        "AVER:TRAC1:COUN 8;:AVER:TYPE LOGP;:TRAC1:MODE AVER",
        "AVER:TRAC1:COUN?;:AVER:TYPE?;:TRAC1:MODE?",
        "8;LOGP;AVER",
        ("siglent",),
    ),
    ("AVER:TYPE VOLT", "AVER:TYPE?", "VOLT", ("siglent",)),
    ("AVER:COUN 8;:TRAC1:TYPE AVER", "AVER:COUN?;:TRAC1:TYPE?", "8;AVER", ("anritsu",)),
    ("DISP:TRAC:MODE MAXH", "DISP:TRAC:MODE?;:AVER?", "MAXH;0", ("rs",)),
    ("TRAC:TYPE MINH", "TRAC:TYPE?;:AVER?", "MINH;0", ("keysight",)),
    ("TRAC1:MODE MAXH", "TRAC1:MODE?", "MAXH", ("siglent",)),
    ("AVER:TYPE MAX", "TRAC1:OPER?;:AVER:TYPE?", "MAXH;MAX", ("anritsu",)),
    ("DISP:WIND:TRAC:Y:RLEV -30", "DISP:WIND:TRAC:Y:SCAL:RLEV?", "-30", ALL),
    ("DISP:WIND1:SUBW1:TRAC1:Y:RLEV -30 DBM", "DISP:TRAC:Y:RLEV?", "-30", ("rs",)),
    ("INP:ATT 20", "INP:ATT?;ATT:AUTO?", "20;0", ("rs",)),
    ("POW:ATT 20", "SENS:POW:RF:ATT?;ATT:AUTO?", "20;0", ("keysight", "siglent", "anritsu")),
    ("INP:GAIN:STAT ON", "INP:GAIN:STAT?", "1", ("rs",)),
    ("POW:GAIN ON", "POW:GAIN:STAT?", "1", ("keysight", "siglent", "anritsu")),
    ("CALC1:UNIT:POW DBUV", "UNIT:POW?", "DBUV", ("rs",)),
    ("UNIT:POW DBMV", "UNIT:POW?", "DBMV", ALL),
    ("INIT:CONT ON", "INIT:CONT?", "1", ALL),
    ("INIT:CONT OFF;:INIT:IMM", "INIT:CONT?;*OPC?", "0;1", ALL),
    ("INIT1:CONT OFF;:INIT1:CONM", "*OPC?", "1", ("rs",)),
    ("INIT:CONT OFF;:INIT", "TRAC:SWE:STAT?", "1", ("siglent",)),
    ("FORM REAL,32", "FORM?", "REAL,32", ("rs", "keysight", "anritsu")),
    ("FORM:TRAC:DATA REAL,64", "FORM:DATA?", "REAL,64", ("keysight",)),
    ("FORM INT,32", "FORM?", "INT,32", ("keysight", "anritsu")),
    ("FORM REAL", "FORM:TRAC:DATA?", "REAL", ("siglent",)),
    ("FORM ASC", "FORM?", "ASC,0", ("rs", "anritsu")),
    ("FORM ASC", "FORM?", "ASC,8", ("keysight",)),
    ("FORM ASC", "FORM?", "ASCii", ("siglent",)),
    ("FORM:BORD SWAP", "FORM:BORD?", "SWAP", ("keysight",)),
    ("INST:SEL SAN", "INST?;:INST:LIST?", "SAN;'SANALYZER','Spectrum'", ("rs",)),
    ("", "CORR:STAT?;:INP:IMP?;:TRIG:SOUR?;:TRIG:LEV?", "0;50;IMM;0", ("rs",)),
    ("SYST:LOC", "SYST:ERR?", '0,"No error"', ("rs", "siglent", "anritsu")),
    ("INST SA", "INST?;:INST:CAT?;:CONF?;:CONF:CAT?", 'SA;"SA 1";SAN;"SAN, CHP"', ("keysight",)),
    ("", "FETC:GPS:FULL?", "NO FIX", ("anritsu",)),
    ("SYST:PRES", "INIT:CONT?;:UNIT:POW?", "1;DBM", ALL),
)
#: dialect -> answers after *RST: INIT:CONT, detector, unit, format, attenuation, reference, centre, span, couplings
AFTER_RESET = {
    "rs": "1;APE;DBM;ASC,0;10;0;13250000000;26500000000;1;1;1",
    "keysight": "0;NORM;DBM;ASC,8;10;0;13250000000;26500000000;1;1;1",
    "siglent": "1;POS;DBM;ASCii;10;0;1600000000;3200000000;1;1;1",
    "anritsu": "1;POS;DBM;ASC,0;10;0;13250000000;26500000000;1;1;1",
}


@pytest.fixture
def bench_of(make_bench: Callable[..., Any]) -> Callable[[str], Any]:
    return lambda name: make_bench(dialect=name)


def cases() -> list[Any]:
    return [pytest.param(name, *row[:3], id=f"{name}: {row[0] or row[1]}") for row in TABLE for name in row[3]]


@pytest.mark.parametrize(("name", "sent", "query", "answer"), cases())
def test_row_is_set_and_read_back(
    bench_of: Callable[[str], Any], name: str, sent: str, query: str, answer: str
) -> None:
    bench = bench_of(name)
    bench.ask(f"*RST;*CLS;{sent}")
    assert bench.errors() == []
    assert bench.ask(query) == answer


@pytest.mark.parametrize("name", ALL)
def test_state_after_reset(bench_of: Callable[[str], Any], name: str) -> None:
    bench = bench_of(name)
    bench.ask("FREQ:CENT 1 GHZ;:UNIT:POW V;*RST")
    attenuation = ATTENUATION[name]
    query = (
        f"INIT:CONT?;:DET?;:UNIT:POW?;:FORM?;{attenuation}?;{REFERENCE[name]}?;:FREQ:CENT?;SPAN?"
        f";:BAND:AUTO?;VID:AUTO?;:SWE:TIME:AUTO?"
    )
    assert bench.ask(query) == AFTER_RESET[name]


@pytest.mark.parametrize(
    ("name", "pattern"),
    [
        ("rs", r"Rohde&Schwarz,FSW-26,[\w.]+/\d+,[\d.]+"),
        ("keysight", r"Keysight Technologies,N9020B,MY\d{8},A\.30\.05"),
        ("siglent", r"Siglent Technologies,SSA3032X,SSA3X\w+,1\.2\.9\.3"),
        ("anritsu", r"Anritsu,MS2090A,\d+,V[\d.]+"),
    ],
)
def test_identity_is_one_that_drivers_know(bench_of: Callable[[str], Any], name: str, pattern: str) -> None:
    assert re.fullmatch(pattern, bench_of(name).ask("*IDN?"))


@pytest.mark.parametrize("name", ALL)
def test_dbw_is_a_unit_of_no_maker(bench_of: Callable[[str], Any], name: str) -> None:
    bench = bench_of(name)
    assert bench.ask("UNIT:POW DBW") == ""
    assert bench.errors() == [-141]
    assert bench.ask("UNIT:POW?") == "DBM"


@pytest.mark.parametrize("name", ALL)
def test_every_unit_of_the_dialect_is_taken(bench_of: Callable[[str], Any], name: str) -> None:
    bench = bench_of(name)
    for unit in DIALECTS[name].units:
        assert bench.ask(f"UNIT:POW {unit};:UNIT:POW?") == unit
    assert bench.errors() == []


@pytest.mark.parametrize("name", ALL)
def test_no_two_rows_meet_in_one_header(name: str) -> None:
    command_tree(DIALECTS[name])


@pytest.mark.parametrize("name", ALL)
def test_every_setting_of_the_section_is_in_the_table(name: str) -> None:
    """The functions of the table are named here, so that a dialect that loses one fails."""
    rows = [row for row in TABLE if name in row[3]]
    for word in ("FREQ", "BAND", "POIN", "SWE:TIME", "DET", "AVER", "RLEV", "ATT", "GAIN", "UNIT", "INIT", "FORM"):
        assert any(word in row[0] for row in rows), word


#: measurement functions of the real instruments that are not simulated
UNKNOWN_FUNCTIONS = {
    "rs": ("CALC:MARK1:X?", "POW:ACH:SPAC?", "FETC:POW:ACP?", "LIST:POW:RES?", "ADJ:LEV"),
    "keysight": ("CALC:MARK1:X?", "READ:ACP?", "READ:OBW?", "FREQ:TUNE:IMM"),
    "siglent": ("CALC:MARK1:X?", "MEAS:ACPR:MAIN?", "MEAS:OBW?", "FREQ:TUNE:IMM"),
    "anritsu": ("CALC:MARK1:X?", "READ:ACP?", "READ:OBW?", "FETC:PEAK?"),
}


@pytest.mark.parametrize("name", ALL)
def test_measurement_functions_but_channel_power_are_unknown(bench_of: Callable[[str], Any], name: str) -> None:
    bench = bench_of(name)
    for message in UNKNOWN_FUNCTIONS[name]:
        assert bench.ask(message) == ""
        assert bench.errors() == [-113], message


@pytest.mark.parametrize("name", ALL)
def test_limits_are_those_of_the_model(bench_of: Callable[[str], Any], name: str) -> None:
    bench, model = bench_of(name), DIALECTS[name].model
    asked = bench.ask("FREQ:STOP? MIN;STOP? MAX;STOP? DEF;:BAND? MIN;:BAND? MAX;:SWE:TIME? MAX")
    expected = (model.min_span_hz, *[model.max_frequency_hz] * 2, *model.rbw.limits[:2], model.sweep_time_s.high)
    assert asked == ";".join(f"{value:.12g}" for value in expected)


PAGE = Path(__file__).parents[3] / "docs" / "evidence" / "simulated-analyzer.md"


def test_page_is_current() -> None:
    assert PAGE.read_text(encoding="utf-8") == markdown_page(), f"write it again: {MARKDOWN_COMMAND} > {PAGE.name}"


def test_every_header_of_every_dialect_is_on_the_page() -> None:
    page = markdown_page().replace("\\|", "|")
    for dialect in DIALECTS.values():
        for row in dialect.commands:
            assert f"| `{row.pattern}` |" in page, row.pattern


def test_every_deviation_stands_on_the_page() -> None:
    page = " ".join(markdown_page().split())
    for dialect in DIALECTS.values():
        assert dialect.deviations
        for sentence in dialect.deviations:
            assert sentence in page
