"""VISA itself: pyvisa over pyvisa-py and over the independent pyvisa-rs, in every dialect, on sockets and HiSLIP."""

import time
from dataclasses import dataclass

import numpy as np
import pytest
import pyvisa

SETUP = "*RST;*CLS;:INIT:CONT OFF;:FREQ:CENT 972 MHZ;SPAN 36e6;:BAND 30 KHZ;:SWE:TIME 2"


@dataclass(frozen=True)
class Language:
    """What a user of the maker's analyzer types."""

    setup: str
    trace: str
    #: choice of a binary format -> its code in pyvisa and its byte order
    blocks: dict[str, tuple[str, bool]]
    no_error: str = '0,"No error"'
    points: int = 2401


LANGUAGES = {
    "rs": Language(
        setup=f"{SETUP};:SWE:POIN 2401;:DET RMS",
        trace="TRAC? TRACE1",
        blocks={"FORM REAL,32": ("f", False)},
    ),
    "keysight": Language(
        setup=f"{SETUP};:SWE:POIN 2401;:DET AVER;:AVER:TYPE RMS",
        trace="TRAC? TRACE1",
        blocks={
            "FORM REAL,32": ("f", True),
            "FORM REAL,32;:FORM:BORD SWAP": ("f", False),
            "FORM REAL,64;:FORM:BORD NORM": ("d", True),
            "FORM REAL,64;:FORM:BORD SWAP": ("d", False),
        },
        no_error='+0,"No error"',
    ),
    # 751 points whatever is asked: the filter must be wider than their distance
    "siglent": Language(
        setup=f"{SETUP};:BAND 100 KHZ;:DET:TRAC AVER;:AVER:TYPE POW",
        trace="TRAC:DATA? 1",
        blocks={"FORM REAL": ("f", False)},
        points=751,
    ),
    "anritsu": Language(
        setup=f"{SETUP};:DISP:POIN 2401;:DET RMS",
        trace="TRAC:DATA? 1",
        blocks={"FORM REAL,32": ("f", False)},
    ),
}


def rows(client, transports):
    return [
        pytest.param(
            transport,
            LANGUAGES[dialect],
            id=f"{transport}-{dialect}",
            marks=pytest.mark.client(
                client, transport=transport, dialect=dialect, work="identity, sweep, trace ASCII = blocks, error queue"
            ),
        )
        for transport in transports
        for dialect in LANGUAGES
    ]


@pytest.mark.parametrize(("transport", "language"), rows("pyvisa-py", ["socket", "HiSLIP"]))
def test_pyvisa_py(analyzer, transport, language):
    work("@py", analyzer, transport, language, chunk_size=1 << 20)


@pytest.mark.parametrize(("transport", "language"), rows("pyvisa-rs", ["socket"]))
def test_pyvisa_rs(analyzer, transport, language):
    work("@rs", analyzer, transport, language)


@pytest.mark.xfail(raises=pyvisa.VisaIOError, reason="pyvisa-rs 0.1.8 opens no HiSLIP: VI_ERROR_NSUP_OPER")
@pytest.mark.client("pyvisa-rs", transport="HiSLIP", dialect="rs", work="open")
def test_pyvisa_rs_hislip(analyzer):
    work("@rs", analyzer, "HiSLIP", LANGUAGES["rs"])


def opened(backend, name, **options):
    return pyvisa.ResourceManager(backend).open_resource(
        name, read_termination="\n", write_termination="\n", timeout=120_000, **options
    )


def sweep_times_out(line):
    """Ask for the end of a sweep of one second and give up after a third of it."""
    line.write("*CLS;*ESE 1;:INIT:CONT OFF;:FREQ:CENT 972 MHZ;SPAN 36 MHZ;:SWE:TIME 1")
    line.timeout = 300
    with pytest.raises(pyvisa.VisaIOError, match="VI_ERROR_TMO"):
        line.query("INIT;*OPC?")
    line.timeout = 120_000


@pytest.mark.client(
    "pyvisa-py", transport="socket", dialect="rs", work="after a timeout the next answer is the old one"
)
def test_pyvisa_py_reads_stale_answers_on_a_socket(slow_analyzer):
    line = opened("@py", slow_analyzer.socket_name)
    sweep_times_out(line)
    assert line.query("*IDN?") == "1"
    assert line.read().startswith("Rohde&Schwarz,")
    line.close()


@pytest.mark.client(
    "pyvisa-py", transport="HiSLIP", dialect="rs", work="after a timeout device clear, then status polls"
)
def test_pyvisa_py_clears_the_device_on_hislip(slow_analyzer):
    line = opened("@py", slow_analyzer.hislip_name)
    sweep_times_out(line)
    line.clear()
    assert line.query("*ESE?") == "1"
    assert line.read_stb() & 32 == 0
    line.write("*OPC")
    began_s = time.monotonic()
    while not line.read_stb() & 32:
        assert time.monotonic() - began_s < 120.0
    assert line.query("*ESR?") == "1"
    line.write("*IDN?")
    began_s = time.monotonic()
    while not line.read_stb() & 16:
        assert time.monotonic() - began_s < 120.0
    assert line.read().startswith("Rohde&Schwarz,")
    assert line.read_stb() & 16 == 0
    assert line.query("SYST:ERR?") == '0,"No error"'
    line.close()


def work(backend, analyzer, transport, language, **options):
    """The first script of the analyzer specification, section 8, with values in place of lengths."""
    line = opened(backend, analyzer.resource_name(transport), **options)
    assert line.query("*IDN?") == analyzer.ask("*IDN?")
    line.write(language.setup)
    assert line.query("INIT;*OPC?").strip() == "1"
    line.write("FORM ASC")
    ascii_dbm = numbers(line.query(language.trace))
    for choice, (code, is_big_endian) in language.blocks.items():
        line.write(choice)
        levels_dbm = line.query_binary_values(language.trace, code, is_big_endian=is_big_endian, container=np.array)
        assert np.max(np.abs(levels_dbm - ascii_dbm)) < 1e-4  # seven digits against 24 bits
    rbw_hz = float(line.query("BAND?"))
    analyzer.check_trace(np.linspace(954e6, 990e6, language.points), ascii_dbm, enbw_hz=1.0645 * rbw_hz)
    assert line.query("SYST:ERR?") == language.no_error
    line.write("NONE:SUCH")
    assert line.query("SYST:ERR?").startswith("-113,")
    assert line.query("SYST:ERR?") == language.no_error
    line.timeout = 300
    with pytest.raises(pyvisa.VisaIOError, match="VI_ERROR_TMO"):
        line.query("NONE:SUCH?")
    line.close()


def numbers(answer):
    """Read an ASCII trace: Siglent ends it with a comma, Anritsu puts the header of a block before it."""
    if answer.startswith("#"):
        answer = answer[2 + int(answer[1]) :]
    return np.array([float(field) for field in answer.rstrip(",").split(",")])
