"""socketscpi, the client of Keysight's application engineers: raw socket, blocks in the byte order of this machine."""

import numpy as np
import pytest
from socketscpi import SocketInstrument, SockInstError

SETUP = (
    "*RST;*CLS;:INIT:CONT OFF;:FREQ:CENT 972 MHZ;SPAN 36e6;:BAND 30 KHZ;:SWE:POIN 2401;TIME 2;:DET AVER;:AVER:TYPE RMS"
)
FREQUENCY_HZ = np.linspace(954e6, 990e6, 2401)


@pytest.mark.client(
    "socketscpi", transport="socket", dialect="keysight", work="sweep, REAL,32 swapped and normal, INT,32, errors"
)
def test_socketscpi(analyzer):
    client = SocketInstrument("127.0.0.1", analyzer.scpi_port, timeout=120, globalErrCheck=True)
    assert client.instId.startswith("Keysight Technologies,N90")
    client.write(SETUP)
    assert client.query("INIT;*OPC?") == "1"
    client.write("FORM REAL,32;:FORM:BORD SWAP")
    swapped_dbm = client.query_binary_values("TRAC? TRACE1", datatype="f")
    analyzer.check_trace(FREQUENCY_HZ, swapped_dbm)
    client.write("FORM:BORD NORM")
    normal_dbm = client.query_binary_values("TRAC? TRACE1", datatype="f").byteswap()
    np.testing.assert_array_equal(normal_dbm, swapped_dbm)
    client.write("FORM INT,32;:FORM:BORD SWAP")
    np.testing.assert_allclose(1e-3 * client.query_binary_values("TRAC? TRACE1", datatype="i"), swapped_dbm, atol=6e-4)
    client.write("FORM REAL,64")
    doubles_dbm = client.query_binary_values("TRAC? TRACE1", datatype="d")
    np.testing.assert_allclose(doubles_dbm, swapped_dbm, atol=1e-4)
    with pytest.raises(SockInstError, match="113"):
        client.write("NONE:SUCH")
    client.err_check()  # raises when anything is left
    client.close()
