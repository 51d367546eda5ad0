"""SCPI without an instrument: framing, units and data elements, parameters; commands that share no header."""

import math

import pytest

from analyzer_sim.scpi.errors import ScpiError
from analyzer_sim.scpi.framing import FramerState, MessageFramer
from analyzer_sim.scpi.parameters import (
    HERTZ,
    PURE,
    SECONDS,
    Boolean,
    Choice,
    Level,
    Numeric,
    Parameter,
    Quoted,
    TraceName,
)
from analyzer_sim.scpi.parser import Block, Character, Number, Text, parse_data, parse_unit, split_units
from analyzer_sim.scpi.tree import CommandTree


def bodies(framer: MessageFramer, data: bytes) -> list[bytes]:
    return [message.body for message in framer.feed(data)]


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (b"*IDN?\n", [b"*IDN?"]),
        (b"*IDN?\r\n", [b"*IDN?"]),
        (b"A;B\nC\n", [b"A;B", b"C"]),
        (b"\n\n", [b"", b""]),
        (b"T 'a\nb'\n", [b"T 'a\nb'"]),
        (b'T "a\nb"\n', [b'T "a\nb"']),
        (b"T 'it''s\n'\nX\n", [b"T 'it''s\n'", b"X"]),
        (b"D #14\n\n\n\n\nX\n", [b"D #14\n\n\n\n", b"X"]),
        (b"D #210'\"34567890\nX\n", [b"D #210'\"34567890", b"X"]),
        (b"D #0abc\nX\n", [b"D #0abc", b"X"]),
        (b"D #H1F\nX\n", [b"D #H1F", b"X"]),
        (b"D #3xx\nX\n", [b"D #3xx", b"X"]),
        (b"D #\nX\n", [b"D #", b"X"]),
        (b"half", []),
    ],
)
def test_message_ends_at_a_line_feed_outside_quotes_and_blocks(data: bytes, expected: list[bytes]) -> None:
    assert bodies(MessageFramer(), data) == expected


@pytest.mark.parametrize(
    "data", [b"T 'a\nb';D #212\n\n\n\n\n\n\n\n\n\n\n\n;E #H1F\r\nX\n", b"D #10\nX #0''\n'\n'\nX\n"]
)
def test_framing_does_not_depend_on_how_the_bytes_arrive(data: bytes) -> None:
    whole = bodies(MessageFramer(), data)
    framer = MessageFramer()
    assert [body for byte in data for body in bodies(framer, bytes([byte]))] == whole


def test_message_beyond_the_limit_is_dropped_and_the_next_one_heard() -> None:
    framer = MessageFramer(limit_bytes=100)
    messages = framer.feed(b"x" * 60) + framer.feed(b"x" * 60)
    assert messages == []
    assert framer.pending_bytes == 0, "nothing of a message that is too long is kept"
    messages = framer.feed(b"tail\n*IDN?\n")
    assert [(m.body, m.is_overrun) for m in messages] == [(b"", True), (b"*IDN?", False)]


def test_message_beyond_the_limit_in_one_piece_is_dropped_too() -> None:
    messages = MessageFramer(limit_bytes=10).feed(b"x" * 20 + b"\nA\n")
    assert [(m.body, m.is_overrun) for m in messages] == [(b"", True), (b"A", False)]


def test_announced_gigabyte_is_not_waited_for() -> None:
    framer = MessageFramer()
    messages = framer.feed(b"D #9999999999abc\n*IDN?\n")
    assert [(m.body, m.is_overrun) for m in messages] == [(b"", True), (b"*IDN?", False)]


@pytest.mark.parametrize("data", [b"T 'open", b'T "open', b"D #15ab", b"D #3100"])
def test_missing_bytes_close_what_is_open(data: bytes) -> None:
    framer = MessageFramer()
    assert framer.feed(data) == []
    assert framer.state in {FramerState.QUOTED, FramerState.BLOCK}
    assert len(framer.feed(framer.missing + b"\n")) == 1
    assert framer.state is FramerState.PLAIN


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


TRACE = TraceName(("TRC",), 4)
DETECTOR = Choice(("RMS", "POSitive"))


@pytest.mark.parametrize(
    ("parameter", "text", "value"),
    [
        (Numeric(HERTZ), "1 MHZ", 1e6),
        (Numeric(HERTZ), "1 mhz", 1e6),
        (Numeric(HERTZ), "2.5GHZ", 2.5e9),
        (Numeric(HERTZ), "1 MAHZ", 1e6),
        (Numeric(HERTZ), "30kHz", 30e3),
        (Numeric(SECONDS), "20 MS", 0.02),
        (Numeric(SECONDS), "5 us", 5e-6),
        (Numeric(PURE), "#HFF", 255.0),
        (Numeric(HERTZ), "MAXIMUM", "MAX"),
        (Numeric(HERTZ), "up", "UP"),
        (Numeric(HERTZ), "INF", math.inf),
        (Numeric(HERTZ), "NINF", -math.inf),
        (Boolean(), "ON", True),
        (Boolean(), "off", False),
        (Boolean(), "0.4", False),
        (Boolean(), "-3", True),
        (DETECTOR, "positive", "POS"),
        (DETECTOR, "POS", "POS"),
        (Quoted(), "'Spectrum'", "Spectrum"),
        (Level(), "-30", -30.0),
        (Level(), "-30 DBM", -30.0),
        (Level(), "MIN", "MIN"),
        (Level(), "1 W", 30.0),
        (Level(), "0 W", -math.inf),
        (Level(), "2 MW", 10.0 * math.log10(2.0)),
        (Level(), "60 DBPW", -30.0),
        (Level(), "1 V", 10.0 * math.log10(20.0)),
        (Level(), "1000 MV", 10.0 * math.log10(20.0)),
        (Level(), "120 DBUV", 10.0 * math.log10(20.0)),
        (TRACE, "1", 1),
        (TRACE, "trc4", 4),
        (Quoted(), "SAN", "SAN"),
    ],
)
def test_fitting_element_gives_its_value(parameter: Parameter, text: str, value: object) -> None:
    read = parameter.read(parse_data(text)[0])
    assert read == pytest.approx(value, rel=1e-15) if isinstance(value, float) else read == value


@pytest.mark.parametrize(
    ("parameter", "text", "code"),
    [
        (Numeric(HERTZ), "1 S", -131),
        (Numeric(PURE), "1 HZ", -138),
        (Numeric(HERTZ), "FOO", -141),
        (Numeric(HERTZ), "'1'", -158),
        (Numeric(HERTZ), "#11a", -168),
        (Boolean(), "MAYBE", -141),
        (Boolean(), "1 HZ", -138),
        (Boolean(), "'ON'", -158),
        (DETECTOR, "1", -128),
        (DETECTOR, "POSI", -141),
        (DETECTOR, "'RMS'", -158),
        (Quoted(), "1", -128),
        (Level(), "1 HZ", -131),
        (Level(), "'1'", -158),
        (TRACE, "5", -224),
        (TRACE, "1.5", -224),
        (TRACE, "TRC5", -141),
        (TRACE, "TRC", -141),
        (TRACE, "1 DB", -138),
        (TRACE, "'TRC1'", -158),
        (TraceName(("TRACE",), 6, is_number_legal=False), "1", -128),
        (Quoted(), "#11a", -168),
    ],
)
def test_other_element_has_its_error(parameter: Parameter, text: str, code: int) -> None:
    with pytest.raises(ScpiError) as caught:
        parameter.read(parse_data(text)[0])
    assert caught.value.code == code


def test_two_commands_cannot_share_a_header() -> None:
    with pytest.raises(ValueError, match="two commands"):
        CommandTree([("A[:B]", "one"), ("A", "two")])
