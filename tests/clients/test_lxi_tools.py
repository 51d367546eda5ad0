"""lxi-tools: a client in C, one process a question."""

import shutil
import subprocess

import numpy as np
import pytest

pytestmark = pytest.mark.skipif(
    shutil.which("lxi") is None, reason="lxi-tools is not installed (apt-get install lxi-tools)"
)


def lxi(analyzer, message):
    """Run one message through the program; return its exit code and what it printed."""
    command = ["lxi", "scpi", "-a", "127.0.0.1", "-p", str(analyzer.scpi_port), "-r", "-t", "60", message]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    return done.returncode, done.stdout.strip()


@pytest.mark.client(
    "lxi-tools", transport="socket", dialect="rs", work="identity, settings, sweep, ASCII trace, error queue"
)
def test_lxi_scpi(analyzer):
    assert lxi(analyzer, "*IDN?") == (0, analyzer.ask("*IDN?"))
    setup = "INIT:CONT OFF;:FREQ:CENT 972 MHZ;SPAN 36 MHZ;:BAND 30 KHZ;:SWE:POIN 2401;TIME 2;:DET RMS"
    assert lxi(analyzer, setup) == (0, "")
    assert lxi(analyzer, "INIT;*OPC?") == (0, "1")
    code, text = lxi(analyzer, "TRAC? TRACE1")
    assert code == 0
    analyzer.check_trace(np.linspace(954e6, 990e6, 2401), [float(field) for field in text.split(",")])
    assert lxi(analyzer, "SYST:ERR?") == (0, '0,"No error"')
    lxi(analyzer, "NONE:SUCH")
    assert lxi(analyzer, "SYST:ERR?")[1].startswith("-113,")
