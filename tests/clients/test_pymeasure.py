"""pymeasure's analyzers of four makers."""

import numpy as np
import pytest
from pymeasure.adapters import VISAAdapter
from pymeasure.instruments.agilent import AgilentE4408B
from pymeasure.instruments.anritsu import AnritsuMS2090A
from pymeasure.instruments.rohdeschwarz import FSL, FSW
from pyvisa import VisaIOError


def adapter(analyzer, transport):
    return VISAAdapter(
        analyzer.resource_name(transport),
        visa_library="@py",
        read_termination="\n",
        write_termination="\n",
        timeout=120_000,
    )


def pymeasure(driver, dialect, work):
    return [
        pytest.param(
            transport,
            id=transport,
            marks=pytest.mark.client("pymeasure", transport=transport, dialect=dialect, work=f"{driver}: {work}"),
        )
        for transport in ("socket", "HiSLIP")
    ]


@pytest.mark.parametrize("driver", [FSL, FSW])
@pytest.mark.parametrize("transport", pymeasure("FSL and FSW", "rs", "settings, sweep, trace"))
def test_rohde_schwarz(analyzer, transport, driver):
    instrument = driver(adapter(analyzer, transport))
    assert instrument.id.startswith("Rohde&Schwarz,FSW")
    instrument.reset()
    instrument.clear()
    instrument.freq_center = "0.972 GHz"
    instrument.freq_span = 36e6
    instrument.res_bandwidth = "30 kHz"
    instrument.video_bandwidth = "AUTO"
    instrument.sweep_time = 2
    instrument.continuous_sweep_enabled = False
    instrument.write("DET RMS;:SWE:POIN 2401")
    assert instrument.sweep_time == 2
    assert instrument.continuous_sweep_enabled is False
    instrument.single_sweep()
    frequency_hz, level_dbm = instrument.read_trace()
    assert (frequency_hz[0], frequency_hz[-1]) == (954e6, 990e6)
    analyzer.check_trace(frequency_hz, level_dbm)
    assert instrument.check_errors() == []
    instrument.write("NONE:SUCH")
    assert [error[0] for error in instrument.check_errors()] == [-113]
    instrument.adapter.close()


@pytest.mark.parametrize(
    "transport", pymeasure("E4408B", "keysight", "settings with trailing semicolons, trace as numbers")
)
def test_agilent_e4408b(analyzer, transport):
    instrument = AgilentE4408B(adapter(analyzer, transport))
    assert instrument.id.startswith("Keysight Technologies,")
    instrument.start_frequency = 954e6
    instrument.stop_frequency = 990e6
    instrument.frequency_points = 2401
    instrument.sweep_time = 2
    instrument.frequency_step = 1e6
    assert instrument.frequency_step == 1e6
    assert instrument.center_frequency == 972e6
    instrument.write(":BAND 30 KHZ;:DET AVER;:AVER:TYPE RMS;:INIT:CONT OFF")
    instrument.write("INIT;*WAI")
    frame = instrument.trace_df(1)
    frequency_hz, level_dbm = frame["Frequency (GHz)"].to_numpy() * 1e9, frame["Peak (dB)"].to_numpy()
    analyzer.check_trace(frequency_hz, level_dbm)
    assert instrument.check_errors() == []
    instrument.write("NONE:SUCH;")
    assert [error[0] for error in instrument.check_errors()] == [-113]
    instrument.adapter.close()


@pytest.mark.parametrize(
    "transport", pymeasure("MS2090A", "anritsu", "settings, channel power by MEAS:CHP:CHP?, density")
)
def test_anritsu_ms2090a(analyzer, transport):
    instrument = AnritsuMS2090A(adapter(analyzer, transport))
    assert instrument.id.startswith("Anritsu,MS2090A,")
    instrument.frequency_start = 954e6
    instrument.frequency_stop = 990e6
    assert instrument.frequency_span == 36e6
    instrument.preamp = False
    instrument.frequency_center = float(analyzer.truth.center_hz[3])
    instrument.frequency_span = float(analyzer.truth.width_hz[3])  # MEASure makes the channel as wide as the span
    instrument.abort()
    power_dbm = instrument.meas_power
    # automatic filter and time: four sigma of the sweep and 0.1 dB of noise that an instrument does not take off
    assert power_dbm == pytest.approx(analyzer.true_powers_dbm()[3], abs=0.7)
    assert instrument.power_density == pytest.approx(power_dbm - 10.0 * np.log10(analyzer.truth.width_hz[3]), abs=1.0)
    assert instrument.meas_power_all[0] == pytest.approx(analyzer.true_powers_dbm()[3], abs=0.7)
    assert instrument.check_errors() == []
    instrument.write("NONE:SUCH")
    assert [error[0] for error in instrument.check_errors()] == [-113]
    instrument.adapter.close()


def anritsu_cannot(attribute, error, reason):
    return pytest.param(
        attribute,
        id=attribute,
        marks=[
            pytest.mark.client("pymeasure", transport="socket", dialect="anritsu", work=f"MS2090A: {attribute}"),
            pytest.mark.xfail(raises=error, reason=reason),
        ],
    )


@pytest.mark.parametrize(
    "attribute",
    [
        anritsu_cannot("fetch_power", VisaIOError, "asks FET:CHP:CHP?; FET is no form of FETCh: -113 and silence"),
        anritsu_cannot(
            "fetch_density", VisaIOError, "asks FET:CHP:DEN?; neither FET nor DEN is a form: -113 and silence"
        ),
        anritsu_cannot("preamp", KeyError, "reads 1 or 0, as SCPI answers a boolean, and knows only ON and OFF"),
        anritsu_cannot(
            "init_continuous", KeyError, "reads 1 or 0, as SCPI answers a boolean, and knows only ON and OFF"
        ),
    ],
)
def test_anritsu_ms2090a_cannot(analyzer, attribute):
    instrument = AnritsuMS2090A(adapter(analyzer, "socket"))
    instrument.adapter.connection.timeout = 500
    getattr(instrument, attribute)
