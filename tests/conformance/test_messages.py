"""Program messages and their units: where they end, how they are joined, what their path is."""

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


def test_message_may_be_longer_than_64_kib(bench, facts):
    assert bench.ask("*ESE?;" * 40000 + ":*ESE?"[1:]) == "0" + ";0" * 40000
    assert bench.errors() == []


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
