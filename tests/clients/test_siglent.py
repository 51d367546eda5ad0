"""rf-bench's SSA3000X: plain socket, ASCII traces with the comma that Siglent leaves at their end."""

import numpy as np
import pytest
from rf_bench.siglent import SSA3000X


@pytest.mark.client(
    "rf-bench-drivers-siglent",
    transport="socket",
    dialect="siglent",
    work="preset, band, averaging, sweep, ASCII trace, peak",
)
def test_ssa3000x(analyzer):
    client = SSA3000X("127.0.0.1", analyzer.scpi_port)
    assert client.identify().startswith("Siglent Technologies,SSA3")
    client.preset()
    client.setup_band(954_000_000, 990_000_000, points=751)
    client.write(":SENS:BAND:RES 100 KHZ;:DET:TRAC AVER;:AVER:TYPE POW;:SWE:TIME 2")
    client.set_ref_level(-20.0)
    client.set_input_attenuation(0)
    assert float(client.query(":BAND?")) == 100e3
    assert client.single_sweep()
    level_dbm = client.get_trace()
    assert len(level_dbm) == client.get_sweep_points()
    frequency_hz = np.linspace(954e6, 990e6, len(level_dbm))
    analyzer.check_trace(frequency_hz, level_dbm, enbw_hz=1.0645 * 100e3)
    peak_hz, peak_dbm = client.get_peak(level_dbm)
    assert peak_dbm == level_dbm.max()
    assert np.min(np.abs(peak_hz - analyzer.truth.center_hz)) < 0.6e6
    assert client.query("SYST:ERR?").startswith('0,"No error"')
    client.write("NONE:SUCH")
    assert client.query("SYST:ERR?").startswith("-113,")
    client.disconnect()
