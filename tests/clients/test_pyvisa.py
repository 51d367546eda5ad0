"""VISA itself: pyvisa over pyvisa-py, over the independent pyvisa-rs, over sockets and HiSLIP."""

import numpy as np
import pytest
import pyvisa

SETUP = "*RST;*CLS;:INIT:CONT OFF;:FREQ:CENT 972 MHZ;SPAN 36e6;:BAND 30 KHZ;:SWE:POIN 2401;TIME 2"
FREQUENCY_HZ = np.linspace(954e6, 990e6, 2401)


def rows(client, transport, **dialects):
    return [
        pytest.param(
            transport,
            *row,
            id=f"{transport}-{dialect}",
            marks=pytest.mark.client(
                client, transport=transport, dialect=dialect, work="identity, sweep, trace ASCII = REAL,32, error queue"
            ),
        )
        for dialect, row in dialects.items()
    ]


RS = ("DET RMS", "FORM REAL,32", False, "TRAC? TRACE1", "0,")


def open_line(backend, name, **options):
    return pyvisa.ResourceManager(backend).open_resource(
        name, read_termination="\n", write_termination="\n", timeout=5000, **options
    )


@pytest.mark.parametrize(
    ("transport", "detector", "binary", "is_big_endian", "query", "no_error"),
    [*rows("pyvisa-py", "socket", rs=RS), *rows("pyvisa-py", "HiSLIP", rs=RS)],
)
def test_pyvisa_py(analyzer, transport, detector, binary, is_big_endian, query, no_error):
    work("@py", analyzer, transport, detector, binary, is_big_endian, query, no_error, chunk_size=1 << 20)


@pytest.mark.parametrize(
    ("transport", "detector", "binary", "is_big_endian", "query", "no_error"), rows("pyvisa-rs", "socket", rs=RS)
)
def test_pyvisa_rs(analyzer, transport, detector, binary, is_big_endian, query, no_error):
    work("@rs", analyzer, transport, detector, binary, is_big_endian, query, no_error)


def work(backend, analyzer, transport, detector, binary, is_big_endian, query, no_error, **options):
    """The first script of the analyzer specification, section 8, with values in place of lengths."""
    line = open_line(backend, analyzer.resource_name(transport), **options)
    line.write(SETUP)
    line.write(detector)
    assert line.query("INIT;*OPC?").strip() == "1"
    line.write(binary)
    binary_dbm = line.query_binary_values(query, "f", is_big_endian=is_big_endian, container=np.array)
    line.write("FORM ASC")
    ascii_dbm = np.array(line.query_ascii_values(query))
    assert len(binary_dbm) == len(ascii_dbm) == 2401
    assert np.max(np.abs(binary_dbm - ascii_dbm)) < 1e-4  # seven digits against 24 bits
    analyzer.check_trace(FREQUENCY_HZ, ascii_dbm)
    assert line.query("SYST:ERR?").startswith(no_error)
    line.write("NONE:SUCH")
    assert line.query("SYST:ERR?").startswith("-113,")
    assert line.query("SYST:ERR?").startswith(no_error)
    line.timeout = 300
    line.write("*CLS")
    with pytest.raises(pyvisa.VisaIOError, match="VI_ERROR_TMO"):
        line.query("NONE:SUCH?")
    line.close()
