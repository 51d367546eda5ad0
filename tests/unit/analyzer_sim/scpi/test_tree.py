"""Headers to commands: short and long forms, optional nodes, suffixes, paths."""

import pytest

from analyzer_sim.scpi.errors import ScpiError
from analyzer_sim.scpi.parser import parse_unit
from analyzer_sim.scpi.tree import CommandTree

ROWS = (
    ("*IDN", "idn"),
    ("[SENSe<6>]:FREQuency:CENTer", "center"),
    ("[SENSe<6>]:FREQuency:SPAN", "span"),
    ("[SENSe<6>]:BANDwidth|BWIDth[:RESolution]", "rbw"),
    ("[SENSe<6>]:BANDwidth|BWIDth[:RESolution]:AUTO", "rbw auto"),
    ("[SENSe<6>]:BANDwidth|BWIDth:VIDeo", "vbw"),
    ("[SENSe<6>][:WINDow<16>]:DETector<6>[:FUNCtion]", "detector"),
)


def find(text: str, *, is_lenient: bool = False) -> list[str]:
    """Return the commands of a message's units; an error as its code."""
    tree = CommandTree(ROWS, is_lenient=is_lenient)
    path: tuple[str, ...] = ()
    found = []
    for unit in text.split(";"):
        try:
            command, path = tree.find(parse_unit(unit), path)
        except ScpiError as error:
            command = str(error.code)
        found.append(command)
    return found


@pytest.mark.parametrize(
    ("header", "command"),
    [
        ("FREQ:CENT", "center"),
        ("FREQUENCY:CENTER", "center"),
        ("frequency:cent", "center"),
        ("SENS:FREQ:CENT", "center"),
        (":SENSE1:FREQ:CENT", "center"),
        ("SENS6:FREQ:CENT", "center"),
        ("BAND", "rbw"),
        ("BWID:RES", "rbw"),
        ("BANDWIDTH:RESOLUTION:AUTO", "rbw auto"),
        ("BAND:AUTO", "rbw auto"),
        ("BWID:VID", "vbw"),
        ("DET2", "detector"),
        ("SENS:WIND3:DET1:FUNC", "detector"),
        ("*IDN?", "idn"),
    ],
)
def test_header_matches_in_short_and_long_form_with_optional_nodes(header: str, command: str) -> None:
    assert find(header) == [command]


@pytest.mark.parametrize(
    ("header", "code"),
    [
        ("FREQU:CENT", "-113"),
        ("FRE:CENT", "-113"),
        ("FREQ", "-113"),
        ("FREQ:CENT:X", "-113"),
        ("FREQ1:CENT", "-113"),
        ("*XYZ", "-113"),
        ("SENS0:FREQ:CENT", "-114"),
        ("SENS7:FREQ:CENT", "-114"),
        ("SENS99999999999999999999:FREQ:CENT", "-114"),
        ("DET7", "-114"),
    ],
)
def test_header_between_the_forms_or_beyond_the_suffix_is_refused(header: str, code: str) -> None:
    assert find(header) == [code]


@pytest.mark.parametrize(
    ("message", "commands"),
    [
        ("FREQ:CENT 1;SPAN 2", ["center", "span"]),
        ("FREQ:CENT 1;FREQ:SPAN 2", ["center", "-113"]),
        ("FREQ:CENT 1;:FREQ:SPAN 2", ["center", "span"]),
        ("FREQ:CENT 1;*IDN?;SPAN 2", ["center", "idn", "span"]),
        ("SENS:BAND:RES 1;VID 2", ["rbw", "vbw"]),
        ("FREQ:CENT 1;NONE 1;SPAN 2", ["center", "-113", "span"]),
    ],
)
def test_relative_header_continues_the_path(message: str, commands: list[str]) -> None:
    assert find(message) == commands


def test_lenient_tree_goes_back_to_the_root() -> None:
    assert find("FREQ:CENT 1;FREQ:SPAN 2;CENT 3", is_lenient=True) == ["center", "span", "center"]


def test_two_commands_cannot_share_a_header() -> None:
    with pytest.raises(ValueError, match="two commands"):
        CommandTree([("A[:B]", "one"), ("A", "two")])
