"""Rohde & Schwarz's own drivers, with their full status discipline: *ESE, *STB? polls, *ESR?, queue drained."""

import numpy as np
import pytest
from RsFsw import RsFsw, enums
from RsFsw.Internal.InstrumentErrors import StatusException as FswStatusException
from RsInstrument import BinFloatFormat, RsInstrument
from RsInstrument.Internal.InstrumentErrors import StatusException

TRANSPORTS = [
    ("socket, own plugin", "socket", "SelectVisa='socket'"),
    ("socket, pyvisa-py", "socket", "SelectVisa='@py'"),
    ("HiSLIP, pyvisa-py", "HiSLIP", "SelectVisa='@py'"),
]


def transports(client, work):
    return [
        pytest.param(*row[1:], id=row[0], marks=pytest.mark.client(client, transport=row[0], dialect="rs", work=work))
        for row in TRANSPORTS
    ]


@pytest.mark.parametrize(
    ("transport", "options"),
    transports("RsInstrument", "reset, sweep with OPC, trace REAL,32 and ASCII, status checks"),
)
def test_rs_instrument(analyzer, transport, options):
    driver = RsInstrument(analyzer.resource_name(transport), True, True, options)
    assert driver.manufacturer == "Rohde&Schwarz"
    assert driver.instrument_model_name.startswith("FSW")
    driver.bin_float_numbers_format = BinFloatFormat.Single_4bytes
    driver.write_str("INIT:CONT OFF;:FREQ:CENT 972 MHZ;SPAN 36 MHZ;:BAND 30 KHZ;:SWE:POIN 2401;TIME 2;:DET RMS")
    driver.write_str_with_opc("INIT:IMM", 5000)
    driver.write_str("FORM REAL,32")
    binary_dbm = driver.query_bin_or_ascii_float_list("TRAC? TRACE1")
    driver.write_str("FORM ASC")
    ascii_dbm = driver.query_bin_or_ascii_float_list("TRAC? TRACE1")
    assert np.max(np.abs(np.array(binary_dbm) - ascii_dbm)) < 1e-4
    analyzer.check_trace(np.linspace(954e6, 990e6, 2401), ascii_dbm)
    assert driver.query_all_errors() is None
    with pytest.raises(StatusException, match="-113"):
        driver.write_str("NONE:SUCH")
    driver.visa_timeout = 500
    with pytest.raises(StatusException, match="-113"):
        driver.query_str("NONE:SUCH?")
    driver.close()


@pytest.mark.parametrize(
    ("transport", "options"),
    transports("RsFsw", "channel power of c00 and of c12 by the marker function, beside the trace"),
)
def test_rs_fsw_channel_power(analyzer, transport, options):
    driver = RsFsw(analyzer.resource_name(transport), True, True, options)
    driver.initiate.continuous.set(False)
    driver.sense.frequency.span.set(5e6)
    driver.sense.bandwidth.resolution.set(10e3)
    driver.calculate.marker.function.power.select.set(enums.MarkerFunctionB.CPOWer)
    driver.utilities.write_str("DET RMS;:SWE:TIME 5")
    for number in (0, 12):
        driver.sense.frequency.center.set(analyzer.truth.center_hz[number])
        assert driver.sense.frequency.center.get() == analyzer.truth.center_hz[number]
        driver.sense.power.achannel.bandwidth.channel.set(analyzer.truth.width_hz[number])
        driver.utilities.write_str_with_opc("INIT", 10000)
        shown_dbm = driver.utilities.query_float("CALC:MARK:FUNC:POW:RES? CPOW")
        trace = (
            np.array(driver.trace.data.x.get(enums.TraceNumber.TRACe1)),
            np.array(driver.utilities.query_bin_or_ascii_float_list("TRAC? TRACE1")),
        )
        # noise is not taken off by an instrument: 1 % of the power at 20 dB; five sigma of the sweep are 0.25 dB
        assert shown_dbm == pytest.approx(analyzer.true_powers_dbm()[number], abs=0.35)
        assert len(trace[0]) == len(trace[1])
    assert driver.utilities.query_all_errors() is None
    with pytest.raises(FswStatusException, match="-113"):
        driver.utilities.write_str("NONE:SUCH")
    driver.close()


@pytest.mark.parametrize(
    ("transport", "options"),
    transports("RsFsw", "every setting by its own methods, trace, self test"),
)
def test_rs_fsw_settings(analyzer, transport, options):
    driver = RsFsw(analyzer.resource_name(transport), True, True, options)
    driver.initiate.continuous.set(False)
    driver.sense.frequency.center.set(972e6)
    driver.sense.frequency.span.set(36e6)
    driver.sense.bandwidth.resolution.set(30e3)
    driver.sense.bandwidth.video.set(300e3)
    driver.sense.sweep.points.set(2401)
    driver.sense.sweep.time.set(2.0)
    driver.sense.window.detector.function.set(enums.DetectorB.RMS)
    driver.display.window.subwindow.trace.y.scale.refLevel.set(-20)
    driver.inputPy.attenuation.set(5)
    assert driver.sense.sweep.points.get() == 2401
    assert driver.sense.window.detector.function.get() is enums.DetectorB.RMS
    driver.utilities.write_str_with_opc("INIT", 10000)
    frequency_hz = driver.trace.data.x.get(enums.TraceNumber.TRACe1)
    analyzer.check_trace(frequency_hz, driver.utilities.query_bin_or_ascii_float_list("TRAC? TRACE1"))
    assert driver.utilities.self_test()[0] == 0
    assert driver.utilities.query_all_errors() is None
    driver.close()
