"""Program messages: headers, elements, numbers."""

import pytest


def test_line_feed_ends_a_message_with_or_without_carriage_return(bench, facts):
    assert bench.send(b"*ESE 4\n*ESE?\r\n") == b"4\n"
    assert bench.errors() == []


def test_line_feed_inside_quotes_does_not_end_a_message(bench, facts):
    assert bench.send(b"UNIT:POW 'D\nBM'\n*ESE?\n") == b"0\n"
    assert bench.errors() == [-158]


@pytest.mark.parametrize("payload", [b"\n\n\n", b";;*ESR?\n", b"'\"\n'", b" ", b"\r", bytes(range(256))])
def test_line_feed_inside_a_block_does_not_end_a_message(bench, payload):
    size = str(len(payload)).encode()
    assert bench.send(b"FREQ:CENT #" + str(len(size)).encode() + size + payload + b"\n*ESE?\n") == b"0\n"
    assert bench.errors() == [-168]


def test_message_may_arrive_in_any_pieces(bench, facts):
    answers = b"".join(bench.send(bytes([byte])) for byte in b"*ESE 8;:FREQ:CENT 1 GHZ;CENT?\r\n*ESE?\n")
    assert answers == b"1000000000\n8\n"


@pytest.mark.parametrize("message", ["", ";", ";;", " ; ; ", "*ESE 1;", ";*ESE 1", ":FREQ:CENT 1 GHZ;", "\t\t"])
def test_empty_units_are_legal(bench, message):
    assert bench.ask(message) == ""
    assert bench.errors() == []


def test_query_with_a_trailing_semicolon_answers(bench):
    bench.ask(":FREQ:STAR 1 GHZ;")
    assert bench.ask(":SENS:FREQ:STAR?;") == "1000000000"
    assert bench.errors() == []


def test_path_of_the_unit_before_is_the_prefix(bench):
    bench.ask("FREQ:CENT 1 GHZ;SPAN 2 MHZ")
    assert bench.ask("FREQ:CENT?;SPAN?;STAR?;STOP?") == "1000000000;2000000;999000000;1001000000"
    assert bench.errors() == []


def test_leading_colon_goes_to_the_root(bench):
    bench.ask("FREQ:CENT 1 GHZ;:FREQ:SPAN 2 MHZ;:BAND 10 KHZ")
    assert bench.ask("FREQ:SPAN?;:BAND?") == "2000000;10000"
    assert bench.errors() == []


def test_path_repeated_after_a_semicolon_is_undefined(bench):
    bench.ask("FREQ:CENT 1 GHZ;FREQ:SPAN 2 MHZ")
    assert bench.errors() == [-113]


def test_lenient_firmware_takes_the_repeated_path(make_bench):
    bench = make_bench(is_lenient=True)
    bench.ask("FREQ:CENT 1 GHZ;FREQ:SPAN 2 MHZ")
    assert bench.ask("FREQ:SPAN?") == "2000000"
    assert bench.errors() == []


def test_common_command_leaves_the_path_alone(bench):
    bench.ask("FREQ:CENT 1 GHZ;*ESE 4;SPAN 2 MHZ;*CLS;STAR?")
    assert bench.ask("FREQ:SPAN?;*ESE?") == "2000000;4"
    assert bench.errors() == []


def test_optional_nodes_that_were_written_belong_to_the_path(bench):
    bench.ask(":SENS:FREQ:CENT 1 GHZ;SPAN 2 MHZ")
    assert bench.ask(":SENS:BAND 10 KHZ;FREQ:SPAN?") == "2000000"
    assert bench.errors() == []


def test_path_does_not_outlive_its_message(bench):
    bench.ask("FREQ:CENT 1 GHZ")
    bench.ask("SPAN 2 MHZ")
    assert bench.errors() == [-113]


def test_message_beyond_all_limits_is_refused_and_the_next_one_heard(bench):
    assert bench.send(b"x" * 5_000_000 + b"\n*ESE?\n") == b"0\n"
    assert bench.errors() == [-223]


@pytest.mark.parametrize("header", ["freq:cent", "FREQuency:CENTer", "SENS:FrEq:cEnTeR", ":sense:frequency:center"])
def test_header_in_either_form_and_any_case(bench, header):
    bench.ask(f"{header} 1.5 GHZ")
    assert bench.ask(f"{header}?") == "1500000000"
    assert bench.errors() == []


@pytest.mark.parametrize("header", ["FRE:CENT", "FREQU:CENT", "FREQ:CENTE", "SENSES:FREQ:CENT", "FREQ"])
def test_nothing_between_short_and_long_form(bench, header):
    bench.ask(f"{header} 1 GHZ")
    assert bench.ask(f"{header}?") == ""
    assert bench.errors() == [-113, -113]


def test_suffix_is_one_when_left_out(bench, name, facts):
    if name in {"rs", "keysight"}:
        bench.ask("SENS1:FREQ:CENT 1 GHZ")
        assert bench.ask("SENSe1:FREQ:CENT?;:SENS:FREQ:CENT?;:FREQ:CENT?") == ";".join(["1000000000"] * 3)
    without = facts.suffix_beyond.replace("9", "")
    assert bench.ask(without.replace(":", "1:", 1)) == bench.ask(without) != ""
    assert bench.errors() == []


def test_suffix_out_of_range(bench, facts):
    assert bench.ask(facts.suffix_beyond) == ""
    assert bench.errors() == [-114]


@pytest.mark.parametrize("suffix", ["0", "99999999999999999999"])
def test_suffix_of_no_sense(bench, facts, suffix):
    header = facts.suffix_beyond.replace("99", suffix).replace("9", suffix if suffix == "0" else "9")
    assert bench.ask(header) == ""
    assert bench.errors() == [-114]


@pytest.mark.parametrize("word", ["asc", "ASC", "ASCii", "ascii", "AsCiI"])
def test_words_in_either_form_and_any_case(bench, word):
    bench.ask(f"FORM {word}")
    assert bench.ask("FORM?").startswith("ASC")
    assert bench.errors() == []


def test_word_between_short_and_long_form(bench):
    bench.ask("FORM ASCI")
    assert bench.errors() == [-141]


@pytest.mark.parametrize("header", ["*IDN", "*CLS?", "*RST?", "INIT?", "SYST:ERR", "*OPT"])
def test_form_that_a_header_does_not_have(bench, header):
    assert bench.ask(header) == ""
    assert bench.errors() == [-113]


def test_identity_is_what_drivers_look_for(bench, facts):
    import re

    assert re.fullmatch(facts.identity, bench.ask("*IDN?"))


@pytest.mark.parametrize("text", ["1013000000", "+1.013e+09 Hz", "1.013 GHz", "1013mhz", "#H3C612740"])
def test_ways_to_write_a_frequency(bench, text):
    bench.ask(f"FREQ:SPAN 1 MHZ;CENT {text}")
    assert float(bench.ask("FREQ:CENT?")) == 1.013e9
    assert bench.errors() == []


@pytest.mark.parametrize("text", ["20", "20 DB", "20db"])
def test_ways_to_write_a_ratio(bench, facts, text):
    bench.ask(f"{facts.attenuation} {text}")
    assert float(bench.ask(f"{facts.attenuation}?")) == 20.0
    assert bench.errors() == []


SETTINGS = ["FREQ:CENT", "FREQ:SPAN", "BAND", "BAND:VID", "SWE:TIME", "DISP:WIND:TRAC:Y:RLEV"]


def limits(bench, header):
    return [float(bench.ask(f"{header}? {word}")) for word in ("MIN", "MAX")]


def slack(header):
    """Half of the span left about a centre that is driven to the edge of the band."""
    return 1e3 if "CENT" in header else 0.0


@pytest.mark.parametrize("header", SETTINGS)
@pytest.mark.parametrize(("word", "position"), [("MIN", 0), ("MINimum", 0), ("max", 1), ("MAXIMUM", 1)])
def test_minimum_and_maximum_are_told_and_taken(bench, header, word, position):
    bench.ask("FREQ:SPAN 1 KHZ")
    low, high = limits(bench, header)
    assert low < high
    bench.ask(f"{header} {word}")
    assert float(bench.ask(f"{header}?")) == pytest.approx((low, high)[position], rel=1e-6, abs=slack(header))
    assert bench.errors() == []


def test_default_up_and_down(bench):
    bench.ask("FREQ:SPAN 1 MHZ;:BAND 10 KHZ")
    bench.ask("BAND UP")
    wider = float(bench.ask("BAND?"))
    bench.ask("BAND DOWN")
    assert float(bench.ask("BAND?")) == 10e3 < wider
    bench.ask("BAND DEF")
    assert float(bench.ask("BAND?")) == float(bench.ask("BAND? DEF"))
    bench.ask("FREQ:CENT 1 GHZ;SPAN 100 MHZ")
    assert bench.ask("FREQ:CENT UP;CENT?;CENT DOWN;CENT?;CENT? UP") == "1010000000;1000000000;1010000000"
    assert bench.errors() == []


@pytest.mark.parametrize(
    ("text", "answer"), [("ON", "1"), ("on", "1"), ("1", "1"), ("OFF", "0"), ("0", "0"), ("2", "1")]
)
def test_booleans_are_answered_as_digits(bench, text, answer):
    bench.ask(f"INIT:CONT {text}")
    assert bench.ask("INIT:CONT?") == answer
    assert bench.errors() == []


def test_units_are_never_returned(bench, facts):
    bench.ask("FREQ:CENT 1.5 GHZ;SPAN 3 MHZ;:BAND 10 KHZ;:SWE:TIME 20 MS;:DISP:WIND:TRAC:Y:RLEV -10 DBM")
    for header in ("FREQ:CENT", "FREQ:SPAN", "BAND", "SWE:TIME", "DISP:WIND:TRAC:Y:RLEV", facts.attenuation):
        float(bench.ask(f"{header}?"))
    assert bench.errors() == []


@pytest.mark.parametrize("header", SETTINGS)
@pytest.mark.parametrize(("value", "position"), [("1E30", 1), ("-1E30", 0)])
def test_value_out_of_range_is_set_to_the_limit_and_reported(bench, header, value, position):
    bench.ask("FREQ:SPAN 1 KHZ")
    limit = limits(bench, header)[position]
    bench.ask(f"{header} {value}")
    assert bench.errors() == [-222]
    assert float(bench.ask(f"{header}?")) == pytest.approx(limit, rel=1e-6, abs=slack(header))


def test_bandwidth_goes_to_a_legal_step(bench, facts):
    bench.ask(f"BAND {facts.rbw_asked_hz}")
    assert float(bench.ask("BAND?")) == facts.rbw_step_hz
    assert bench.errors() == []


def test_couplings_follow_the_span(bench, facts):
    bench.ask("FREQ:CENT 1 GHZ;SPAN 100 MHZ;:BAND:AUTO ON;:BAND:VID:AUTO ON;:SWE:TIME:AUTO ON")
    wide = [float(bench.ask(query)) for query in ("BAND?", "BAND:VID?", "SWE:TIME?")]
    assert 0.5 < wide[0] * facts.span_per_rbw / 100e6 < 2.0
    bench.ask("FREQ:SPAN 1 MHZ")
    narrow = [float(bench.ask(query)) for query in ("BAND?", "BAND:VID?", "SWE:TIME?")]
    assert narrow[0] < wide[0]
    assert narrow[1] < wide[1]
    bench.ask("BAND 100 KHZ")
    assert bench.ask("BAND:AUTO?") == "0"
    assert float(bench.ask("SWE:TIME?")) <= narrow[2]
    assert bench.errors() == []
