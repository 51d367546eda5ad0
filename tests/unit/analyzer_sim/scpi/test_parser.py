"""Units, headers and data elements."""

import pytest

from analyzer_sim.scpi.errors import ScpiError
from analyzer_sim.scpi.parser import Block, Character, Number, Text, parse_data, parse_unit, split_units


@pytest.mark.parametrize(
    ("message", "units"),
    [
        (b"A;B", ["A", "B"]),
        (b":SENS:FREQ:STAR?;", [":SENS:FREQ:STAR?"]),
        (b";;  ;A", ["A"]),
        (b"", []),
        (b"T 'a;b';C", ["T 'a;b'", "C"]),
        (b"D #13a;b;C", ["D #13a;b", "C"]),
        (b"D #0a;b;C", ["D #0a;b;C"]),
        (b"T 'open;C", ["T 'open;C"]),
    ],
)
def test_units_are_cut_at_semicolons_outside_quotes_and_blocks(message: bytes, units: list[str]) -> None:
    assert split_units(message) == units


@pytest.mark.parametrize(
    ("text", "nodes", "is_absolute", "is_query"),
    [
        ("*idn?", ("*IDN",), False, True),
        (":sens1:freq 1", ("SENS1", "FREQ"), True, False),
        ("FREQ:CENT?\tMIN", ("FREQ", "CENT"), False, True),
    ],
)
def test_header_is_read_without_case(text: str, nodes: tuple[str, ...], is_absolute: bool, is_query: bool) -> None:
    unit = parse_unit(text)
    assert (unit.nodes, unit.is_absolute, unit.is_query) == (nodes, is_absolute, is_query)


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("FREQ::CENT 1", -102),
        (":", -102),
        ("*?", -102),
        ("?", -102),
        ("FREQ??", -102),
        ("FREQ,1", -103),
        ("FREQ'a'", -103),
        ("\xff\xfe", -101),
        ("FREQ\xb0", -101),
        ("&GTL", -101),
        ("123", -101),
    ],
)
def test_malformed_header_has_its_error(text: str, code: int) -> None:
    with pytest.raises(ScpiError) as caught:
        parse_unit(text)
    assert caught.value.code == code


@pytest.mark.parametrize(
    ("text", "datum"),
    [
        ("1.01325e+09", Number(1.01325e9)),
        ("1.013 GHz", Number(1.013, "GHZ")),
        ("30 kHz", Number(30.0, "KHZ")),
        ("1.010000e+09 Hz", Number(1.01e9, "HZ")),
        ("5000000.0", Number(5e6)),
        ("-.5", Number(-0.5)),
        ("+1.E3", Number(1000.0)),
        ("1 e -3", Number(1e-3)),
        ("1e-32000", Number(0.0)),
        ("#H1f", Number(31.0)),
        ("#Q17", Number(15.0)),
        ("#b101", Number(5.0)),
        ("max", Character("MAX")),
        ("'it''s'", Text("it's")),
        ('"a,b;c"', Text("a,b;c")),
        ("#13abc", Block(b"abc")),
        ("#0abc", Block(b"abc")),
        ("#10", Block(b"")),
    ],
)
def test_data_element_is_read_by_its_type(text: str, datum: object) -> None:
    assert parse_data(text) == (datum,)


def test_several_elements_are_separated_by_commas() -> None:
    assert parse_data("REAL , 32") == (Character("REAL"), Number(32.0))


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("1,,2", -102),
        (",", -102),
        ("(@1,2)", -104),
        ("\xb0", -101),
        ("+", -120),
        (".", -120),
        ("1e99999", -123),
        ("1" * 300, -124),
        ("1.2.3", -121),
        ("1 MHZ!", -121),
        ("#HXY", -121),
        ("#B12", -121),
        ("AB-C", -141),
        ("A" * 40, -144),
        ("'open", -151),
        ("'a'b'", -151),
        ("'", -151),
        ("#15ab", -161),
        ("#", -161),
        ("#x", -161),
    ],
)
def test_malformed_data_has_its_error(text: str, code: int) -> None:
    with pytest.raises(ScpiError) as caught:
        parse_data(text)
    assert caught.value.code == code
