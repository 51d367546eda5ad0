"""Headers and words: case, short and long forms, optional nodes, numeric suffixes."""

import pytest


@pytest.mark.parametrize(
    "header",
    [
        "FREQ:CENT",
        "freq:cent",
        "FREQuency:CENTer",
        "frequency:center",
        "FrEq:cEnTeR",
        ":FREQ:CENT",
        "SENS:FREQ:CENT",
        ":SENSe:FREQuency:CENTer",
        "sense:freq:center",
    ],
)
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
