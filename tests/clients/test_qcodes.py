"""QCoDeS: the Keysight N9030B of its own and the FSV 3013 contributed to it."""

import numpy as np
import pytest
from pyvisa import VisaIOError
from qcodes.instrument_drivers.Keysight import KeysightN9030B
from qcodes_contrib_drivers.drivers.RohdeSchwarz.FSV_3013 import RFSpectrumAnalyzer


@pytest.fixture
def opened():
    """Instruments to close whatever happens: QCoDeS keeps a registry of their names."""
    instruments = []
    yield instruments.append
    for instrument in instruments:
        instrument.close()


@pytest.mark.client(
    "qcodes",
    transport="socket",
    dialect="keysight",
    work="N9030B: catalogues, options, READ:SAN1? and FETC:SAN1? in REAL,64",
)
def test_keysight_n9030b(analyzer, opened):
    instrument = KeysightN9030B("pxa", analyzer.socket_name, visalib="@py")
    opened(instrument)
    assert instrument.get_idn()["vendor"] == "Keysight Technologies"
    assert "SA" in instrument.available_modes()
    instrument.sa.setup_swept_sa_sweep(954e6, 990e6, 2401)
    assert instrument.measurement() == "SAN"
    assert instrument.cont_meas() is False
    instrument.sa.res_bw(30e3)
    instrument.sa.detector("AVER")
    instrument.sa.average_type("RMS")
    instrument.sa.sweep_time(2.0)
    instrument.sa.sweep_type("sweep")
    instrument.sa.mech_attenuation(0)
    instrument.sa.preamp_enabled(False)
    level_dbm = instrument.sa.trace()
    frequency_hz = instrument.sa.freq_axis()
    assert (frequency_hz[0], frequency_hz[-1], len(frequency_hz)) == (954e6, 990e6, 2401)
    analyzer.check_trace(frequency_hz, level_dbm)
    instrument.auto_sweep(False)
    np.testing.assert_array_equal(instrument.sa.trace(), level_dbm)
    assert instrument.ask("SYST:ERR?") == '+0,"No error"'
    instrument.write("NONE:SUCH")
    assert instrument.ask("SYST:ERR?").startswith("-113,")


@pytest.mark.client(
    "qcodes-contrib-drivers",
    transport="socket",
    dialect="rs",
    work="FSV 3013: settings, trace; its FORM:TRAC is no header of R&S",
)
def test_rohde_schwarz_fsv_3013(analyzer, opened):
    instrument = RFSpectrumAnalyzer("fsv", analyzer.socket_name, visalib="@py", terminator="\n", timeout=120)
    opened(instrument)
    instrument.reset()
    instrument.frequency(972e6)
    instrument.span(36e6)
    instrument.resolution_bandwidth(30e3)
    instrument.video_bandwidth(300e3)
    instrument.sweep_time(2)
    instrument.sweep_mode("OFF")
    instrument.reference_level(-20)
    instrument.write("DET RMS;:SWE:POIN 2401")
    assert instrument.frequency() == 972e6
    assert instrument.reference_level() == -20
    assert instrument.sweep_mode() == "0"
    assert instrument.input_impedance() == 50
    assert instrument.trigger_source() == "IMM"
    assert instrument.correction_state() == "0"
    frequency_hz, level_dbm = instrument.get_trace()
    analyzer.check_trace(frequency_hz, level_dbm)
    assert instrument.ask("SYST:ERR?").startswith("-113,")  # the driver's :FORM:TRAC ASC, which only Keysight has
    assert instrument.ask("SYST:ERR?") == '0,"No error"'
    instrument.timeout(0.5)
    with pytest.raises(VisaIOError, match="VI_ERROR_TMO"):
        instrument.measurement_state()  # asks :INIT:IMM?, an event without a query
