"""Every row of the table of commands (analyzer specification, section 1) is set and read back; its page is current."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from analyzer_sim.dialects.dialects import DIALECTS
from docs.dialect_page import MARKDOWN_COMMAND, markdown_page

ALL = ("rs", "keysight", "siglent", "anritsu")
ATTENUATION = {"rs": ":INP:ATT", "keysight": ":POW:ATT", "siglent": ":POW:ATT", "anritsu": ":POW:RF:ATT"}
TABLE: tuple[tuple[str, str, str, tuple[str, ...]], ...] = (
    ("FREQ:CENT 1.017 GHZ", "FREQ:CENT?", "1017000000", ALL),
    ("FREQ:SPAN 20 MHZ", "FREQ:SPAN?", "20000000", ALL),
    ("FREQ:STAR 954 MHZ;STOP 990 MHZ", "FREQ:STAR?;STOP?", "954000000;990000000", ALL),
    ("FREQ:OFFS 1 GHZ", "FREQ:OFFS?", "1000000000", ALL),
    ("BAND 30 KHZ", "BAND?;:BWID:RES?;:BAND:AUTO?", "30000;30000;0", ALL),
    ("BWID:VID 300 KHZ", "BAND:VID?;VID:AUTO?", "300000;0", ALL),
    ("BAND:AUTO OFF;VID:AUTO OFF", "BAND:AUTO?;VID:AUTO?", "0;0", ALL),
    ("SENS:WIND1:FREQ:CENT 1 GHZ", "SENS:WIND1:FREQ:CENT?;:FREQ:CENT?", "1000000000;1000000000", ("rs",)),
    ("", "*OPT?;:SYST:VERS?;:SWE:TYPE?;:AVER:TYPE?;:SWE:POIN? DEF", "0;1999.0;AUTO;VID;1001", ("rs",)),
    ("SWE:TIME 200 MS", "SWE:DUR?", "0.2", ("rs",)),
    ("", "FREQ:CENT? MIN;CENT? MAX", "5;26499999995", ("rs",)),
    ("", "FREQ:SPAN 1e12;:SYST:ERR:ALL?", '-222,"Data out of range;1e+12"', ("rs",)),
    ("FORM REAL", "FORM:DATA?", "REAL,32", ("rs",)),
    ("FORM REAL,32;:FORM ASC,0", "FORM?", "ASC,0", ("rs",)),
    ("AVER ON", "AVER:STAT1?;:DISP:WIND1:SUBW1:TRAC1:MODE?", "1;AVER", ("rs",)),
    ("DET1:FUNC POSITIVE", "DET?;:DET:AUTO?", "POS;0", ("rs",)),
    ("AVER:TYPE POW", "AVER:TYPE?", "POW", ("rs",)),
    ("INST 'Spectrum'", "INST?", "SAN", ("rs",)),
    ("SYST:DISP:UPD ON", "SYST:DISP:UPD?", "1", ("rs",)),
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
    ("", "FETC:GPS:FULL?;LAST?;ALL?;:FETC:GPS?", "NO FIX;NO FIX;NO FIX;NO FIX", ("anritsu",)),
    ("SYST:PRES", "INIT:CONT?;:UNIT:POW?", "1;DBM", ALL),
)
#: dialect -> answers after *RST: INIT:CONT, detector, unit, format, attenuation, reference, centre, span, couplings
AFTER_RESET = {
    "rs": "1;APE;DBM;ASC,0;10;0;13250000000;26500000000;1;1;1",
    "keysight": "0;NORM;DBM;ASC,8;10;0;13250000000;26500000000;1;1;1",
    "siglent": "1;POS;DBM;ASCii;10;0;1600000000;3200000000;1;1;1",
    "anritsu": "1;POS;DBM;ASC,0;10;0;13250000000;26500000000;1;1;1",
}


def cases() -> list[Any]:
    return [pytest.param(name, *row[:3], id=f"{name}: {row[0] or row[1]}") for row in TABLE for name in row[3]]


@pytest.mark.parametrize(("name", "sent", "query", "answer"), cases())
def test_row_is_set_and_read_back(
    make_bench: Callable[..., Any], name: str, sent: str, query: str, answer: str
) -> None:
    bench = make_bench(name)
    bench.ask(f"*RST;*CLS;{sent}")
    assert bench.errors() == []
    assert bench.ask(query) == answer


@pytest.mark.parametrize("name", ALL)
def test_state_after_reset(make_bench: Callable[..., Any], name: str) -> None:
    bench = make_bench(name)
    bench.ask("FREQ:CENT 1 GHZ;:UNIT:POW V;*RST")
    attenuation = ATTENUATION[name]
    query = (
        f"INIT:CONT?;:DET?;:UNIT:POW?;:FORM?;{attenuation}?;:DISP:WIND:TRAC:Y:SCAL:RLEV?;:FREQ:CENT?;SPAN?"
        f";:BAND:AUTO?;VID:AUTO?;:SWE:TIME:AUTO?"
    )
    assert bench.ask(query) == AFTER_RESET[name]


@pytest.mark.parametrize("name", ALL)
def test_dbw_is_a_unit_of_no_maker(make_bench: Callable[..., Any], name: str) -> None:
    bench = make_bench(name)
    assert bench.ask("UNIT:POW DBW") == ""
    assert bench.errors() == [-141]
    assert bench.ask("UNIT:POW?") == "DBM"


@pytest.mark.parametrize(
    ("name", "kind", "detector"),
    [
        *(("keysight", *row) for row in (("RMS", "RMS"), ("LOG", "AVER"), ("SCAL", "LIN"))),
        *(("siglent", *row) for row in (("POW", "RMS"), ("LOGP", "AVER"), ("VOLT", "LIN"))),
    ],
)
def test_average_detector_follows_the_average_type(
    make_bench: Callable[..., Any], name: str, kind: str, detector: str
) -> None:
    bench = make_bench(name)
    bench.ask(f"DET:TRAC1 AVER;:AVER:TYPE {kind}")
    assert bench.instrument.settings.detector == detector
    assert bench.ask("DET:TRAC1?") == "AVER"


@pytest.mark.parametrize("name", ALL)
def test_every_unit_of_the_dialect_is_taken(make_bench: Callable[..., Any], name: str) -> None:
    bench = make_bench(name)
    for unit in DIALECTS[name].units:
        assert bench.ask(f"UNIT:POW {unit};:UNIT:POW?") == unit
    assert bench.errors() == []


#: what is refused after some setting, and the measurement functions of the real instruments that are not simulated
REFUSED: dict[str, dict[int, tuple[str, ...]]] = {
    "rs": {
        -109: ("TRAC?", "CALC:MARK:FUNC:POW:RES?"),
        -113: ("FORM:BORD SWAP", "CALC:MARK1:X?", "POW:ACH:SPAC?", "FETC:POW:ACP?", "LIST:POW:RES?", "ADJ:LEV"),
        -114: ("CALC1:MARK17:FUNC:POW:SEL?",),
        -128: ("DET 5", "CALC:MARK:FUNC:POW:SEL 5", "POW:ACH:BWID? 1"),
        -131: ("POW:ACH:BWID 1 S",),
        -141: (
            "FORM INT,32",
            "TRAC? TRACE7",
            "CALC:MARK:FUNC:POW:RES? OBW",
            "CALC:MARK:FUNC:POW:SEL ACP",
            "POW:ACH:BWID UP",
        ),
        -222: ("POW:ACH:BWID 1", "POW:ACH:TXCH:COUN 2"),
        -224: ("FORM REAL,64", "INST:SEL 'NOISE'", "CALC:MARK:FUNC:POW ON"),
    },
    "keysight": {
        -108: ("READ:CHP? 1",),
        -113: ("CONF:XYZ", "MEAS:CHP", "CALC:MARK1:X?", "READ:ACP?", "READ:OBW?", "FREQ:TUNE:IMM"),
        -131: ("CHP:BAND:INT 1 S", "CHP:SWE:TIME 1 HZ"),
        -141: ("CHP:BAND UP",),
        -158: ("CHP:BAND:AUTO 'x'",),
        -213: ("INIT:CONT ON;:INIT:CHP",),
        -221: ("UNIT:POW DBUVM",),
        -222: ("CHP:BAND:INT 1", "CHP:BAND 99 GHZ", "CHP:AVER:COUN 0"),
    },
    "siglent": {
        -108: ("MEAS:CHP? 1",),
        -113: ("MEAS:CHP", "FORM:BORD SWAP", "CALC:MARK1:X?", "MEAS:ACPR:MAIN?", "MEAS:OBW?", "FREQ:TUNE:IMM"),
        -138: ("TRAC:DATA? 1 HZ",),
        -141: ("INST:MEAS OBW", "TRAC:DATA? TRC5", "TRAC:DATA? FOO1"),
        -221: ("FREQ:SPAN 0;:MEAS:CHP?",),
        -222: ("CHP:BWID:INT 1", "CHP:BWID:INT 4 GHZ"),
        -224: ("TRAC:DATA? 5",),
        -230: ("INIT:CONT OFF;:INIT;*WAI;:TRAC:DATA? 2",),
    },
    "anritsu": {
        -113: ("CONF:XYZ", "FETC:CHP", "SWE:POIN 501", "CALC:MARK1:X?", "READ:ACP?", "READ:OBW?", "FETC:PEAK?"),
        -114: ("FETC:CHP3?",),
        -131: ("CHP:BWID:INT 1 S",),
        -222: ("CHP:BWID:INT 99 GHZ",),
    },
}


@pytest.mark.parametrize(("name", "code"), [(name, code) for name in ALL for code in REFUSED[name]])
def test_wrong_unit_queues_its_error_and_answers_nothing(make_bench: Callable[..., Any], name: str, code: int) -> None:
    bench = make_bench(name)
    for message in REFUSED[name][code]:
        assert bench.ask(message) == ""
        assert bench.errors() == [code], message


@pytest.mark.parametrize("name", ALL)
def test_limits_are_those_of_the_model(make_bench: Callable[..., Any], name: str) -> None:
    bench, model = make_bench(name), DIALECTS[name].model
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
