"""R&S measurement functions: what each header sets and answers, the list, and wrong parameters."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from analyzer_sim.emission import Signal

# carriers of the bench: a 1012 MHz 1 MHz -40 dBm, b 1017 MHz 2 MHz -43 dBm, c 1022 MHz 0.5 MHz -46 dBm; -120 dBm/Hz
SETUP = "*RST;*CLS;:INIT:CONT OFF;:FREQ:CENT 1017 MHZ;SPAN 20e6;:BAND 30 KHZ;:SWE:POIN 2001;TIME 10;:DET RMS;:INIT"
POWER = "CALC:MARK:FUNC:POW"
ENTRY = "1012 MHZ,-20 DBM,0 DB,OFF,NORM,1 MHZ,10 MHZ,10 MS,0"


@pytest.fixture
def swept(bench: Any) -> Any:
    bench.ask(SETUP)
    return bench


def numbers(text: str) -> np.ndarray:
    return np.array(text.split(","), dtype=float)


def test_channel_power_and_its_density(swept: Any) -> None:
    swept.ask(f"{POWER}:SEL CPOW;:POW:ACH:BWID 2.5 MHZ;ACP 0")
    power_dbm = float(swept.ask(f"{POWER}:RES? CPOW"))
    noise_mw = 10 ** ((-120 + 10 * math.log10(2.5e6)) / 10)
    assert power_dbm == pytest.approx(10 * math.log10(10**-4.3 + noise_mw), abs=0.08)  # sigma 0.02 dB
    density = float(swept.ask(f"{POWER}:RES:PHZ ON;:{POWER}:RES? CPOW"))
    assert density == pytest.approx(power_dbm - 10 * math.log10(2.5e6), abs=1e-6)
    watts = float(swept.ask(f"UNIT:POW W;:{POWER}:RES:PHZ OFF;:{POWER}:RES? CPOW"))
    assert watts == pytest.approx(1e-3 * 10 ** (power_dbm / 10), rel=1e-6)
    assert swept.ask("FETC:CPOW:RES?") == swept.ask(f"{POWER}:RES? CPOW")
    assert swept.errors() == []


def test_neighbours_relative_and_absolute(swept: Any) -> None:
    swept.ask("POW:ACH:BWID 2.5 MHZ;ACP 1;SPAC 5 MHZ;BWID:ACH 1.5 MHZ")
    main, lower, upper = numbers(swept.ask(f"{POWER}:RES? ACP"))
    assert (lower, upper) == pytest.approx((2.9, -2.7), abs=0.3)
    absolute = numbers(swept.ask("POW:ACH:MODE ABS;:FETC:POW:ACP?"))
    np.testing.assert_allclose(absolute, [main, main + lower, main + upper], atol=1e-9)
    assert swept.ask("POW:ACH:ACP 2;:FETC:POW:ACP?").split(",")[3:] == ["9.91E37"] * 2  # at twice 5 MHz: outside
    assert swept.ask("POW:ACH:SPAC:ALT1?;ALT2?;:POW:ACH:BWID:ALT3?") == "10000000;15000000;1500000"
    assert "9.91E37" not in swept.ask("POW:ACH:SPAC:ALT1 9 MHZ;:FETC:POW:ACP?")
    assert swept.ask("POW:ACH:SPAC:ALT1?") == "9000000"
    assert swept.errors() == []


def test_occupied_bandwidth_by_percent(swept: Any) -> None:
    swept.ask(f"FREQ:SPAN 6 MHZ;:INIT;:POW:BWID 90PCT;:{POWER}:SEL OBW")
    ninety = float(swept.ask(f"{POWER}:RES? OBW"))
    # 1.81 MHz of a raised cosine of 2 MHz; a tenth of the power of the trace is noise and lies outside
    assert ninety == pytest.approx(2.0e6, abs=0.1e6)
    assert float(swept.ask(f"POW:BWID 99;:{POWER}:RES? OBW")) > ninety
    assert swept.ask("POW:BWID?") == "99"


def test_carrier_to_noise_needs_a_channel_of_noise(make_bench: Callable[..., Any]) -> None:
    bench = make_bench(signals=(Signal("line", 1012e6, 0.0, 0.0, -40.0),))
    bench.ask(SETUP + ";:POW:ACH:BWID 2 MHZ")
    # -40 dBm over -120 dBm/Hz in 2 MHz
    assert float(bench.ask(f"{POWER}:RES? CN")) == pytest.approx(17.0, abs=0.2)
    assert float(bench.ask(f"{POWER}:RES? CN0")) == pytest.approx(80.0, abs=0.2)


def test_selecting_a_power_measurement_takes_the_rms_detector_when_it_is_automatic(bench: Any) -> None:
    assert bench.ask(f"DET:AUTO ON;:{POWER}:SEL CPOW;:DET?;:{POWER}:SEL?;:{POWER}?") == "RMS;CPOW;1"
    assert bench.ask(f"{POWER}:PRES NONE;:{POWER} OFF;:{POWER}:SEL?;:{POWER}?") == "OFF;0"
    assert bench.ask(f"DET POS;:{POWER}:SEL OBW;:DET?") == "POS"


def test_markers_are_placed_read_and_searched(swept: Any) -> None:
    swept.ask("CALC:MARK1 ON")
    assert float(swept.ask("CALC:MARK1:X?")) == pytest.approx(1012e6, abs=0.6e6)  # the highest carrier
    swept.ask("CALC:MARK1:PEXC 10 DB;MAX:RIGH")  # densities: a, then c, then b
    assert float(swept.ask("CALC:MARK1:X?")) == pytest.approx(1022e6, abs=0.3e6)
    swept.ask("CALC:MARK1:MAX:RIGH")  # none is lower and further: it stays
    assert float(swept.ask("CALC:MARK1:X?")) == pytest.approx(1022e6, abs=0.3e6)
    swept.ask("CALC:MARK1:MAX:NEXT")
    assert float(swept.ask("CALC:MARK1:X?")) == pytest.approx(1017e6, abs=1.1e6)
    assert swept.ask("CALC:MARK1:MIN;:CALC:MARK1:PEXC?;:CALC:MARK2?;:CALC:MARK1?") == "10;0;1"
    assert swept.ask("CALC:MARK:AOFF;:CALC:MARK1?") == "0"
    assert swept.errors() == []


def test_marker_stands_on_a_point_and_knows_the_frequency_offset(swept: Any) -> None:
    assert swept.ask("FREQ:OFFS 1 GHZ;:INIT;:CALC:MARK3:X 2.0170042 GHZ;X?") == "2017000000"
    level = float(swept.ask("CALC:MARK3:Y?"))
    trace = numbers(swept.ask("TRAC? TRACE1"))
    assert level == pytest.approx(trace[1000], abs=1e-4)
    assert swept.ask("CALC:MARK3:FUNC:CENT;:FREQ:CENT?") == "2017000000"


def test_band_and_noise_markers(swept: Any) -> None:
    swept.ask("CALC:MARK2:X 1017 MHZ;:CALC:MARK2:FUNC:BPOW ON;BPOW:SPAN 2.5 MHZ;:POW:ACH:BWID 2.5 MHZ")
    power = swept.ask("CALC:MARK2:FUNC:BPOW:RES?")
    assert power == swept.ask(f"{POWER}:RES? CPOW")
    density = float(swept.ask("CALC:MARK2:FUNC:BPOW:MODE DENS;RES?"))
    assert density == pytest.approx(float(power) - 10 * math.log10(2.5e6), abs=1e-6)
    swept.ask("CALC:MARK2:FUNC:BPOW:AOFF;:CALC:MARK4:X 1008.5 MHZ;:CALC:MARK4:FUNC:NOIS ON")
    assert swept.ask("CALC:MARK2:FUNC:BPOW?;:CALC:MARK4:FUNC:NOIS?") == "0;1"
    assert float(swept.ask("CALC:MARK4:FUNC:NOIS:RES?")) == pytest.approx(-120.0, abs=0.3)


def test_list_is_measured_on_one_row_and_answers_what_is_switched_on(bench: Any) -> None:
    bench.ask("INIT:CONT OFF;:LIST:POW:SET ON,ON,ON,IMM,POS,0,0")
    answer = numbers(bench.ask(f"LIST:POW? {ENTRY},{ENTRY.replace('1012', '1017')}"))
    assert bench.source.row == 1
    peak, rms, mean = answer[:3]
    assert peak > rms > mean
    # 1 MHz filter on a carrier of 1 MHz: two thirds of it; N = 150: 0.35 dB
    assert rms == pytest.approx(-40.0 + 10 * math.log10(0.83), abs=1.2)
    assert rms - mean == pytest.approx(2.51, abs=1.5)
    np.testing.assert_allclose(numbers(bench.ask("LIST:POW:RES?")), answer)
    assert len(bench.ask(f"LIST:POW:SET OFF,ON,OFF,IMM,POS,0,0;:LIST:POW? {ENTRY}").split(",")) == 1
    assert bench.ask("LIST:POW:SET?;:LIST:POW:STAT?") == "0,1,0,IMM,POS,0,0;0"
    assert bench.errors() == []


def test_list_takes_entries_with_and_without_electronic_attenuation_up_to_two_hundred(bench: Any) -> None:
    short = "1012e6,-20,0,NORM,1e6,1e7,0.001,0"
    for entry in (short, short.replace("NORM", "OFF,NORM"), short.replace("NORM", "0,NORM")):
        assert len(bench.ask("LIST:POW? " + ",".join([entry] * 200)).split(",")) == 200
    bench.ask("LIST:POW? " + ",".join([short] * 201))
    assert bench.errors() == [-223]


def test_command_starts_the_list_and_its_results_wait(make_bench: Callable[..., Any]) -> None:
    allowed: list[bool] = []
    bench = make_bench(may_advance=lambda: bool(allowed))
    bench.ask(f"INIT:CONT OFF;:LIST:POW {ENTRY};*OPC")
    assert bench.instrument.is_pending
    assert bench.ask("LIST:POW:RES?") == ""
    allowed.append(True)
    bench.instrument.complete_pending()
    assert float(bench.go_on()) == pytest.approx(-41.0, abs=2.0)
    assert bench.ask("*ESR?") == "129"


def test_query_of_the_list_starts_it_once_and_waits(make_bench: Callable[..., Any]) -> None:
    allowed: list[bool] = []
    bench = make_bench(may_advance=lambda: bool(allowed))
    bench.ask("INIT:CONT OFF")
    assert bench.ask(f"LIST:POW? {ENTRY}") == ""
    assert bench.session.is_held
    assert bench.go_on() == b""
    allowed.append(True)
    bench.instrument.complete_pending()
    assert float(bench.go_on()) == pytest.approx(-41.0, abs=2.0)
    assert (bench.source.row, bench.errors()) == (1, [])


@pytest.mark.parametrize(
    ("message", "code"),
    [
        (f"{POWER}:RES?", -109),
        (f"{POWER}:RES? XPOW", -141),
        (f"{POWER}:SEL 5", -128),
        (f"{POWER} ON", -224),
        (f"{POWER}:PRES GSM", -141),
        ("POW:ACH:BWID 1", -222),
        ("POW:ACH:BWID 1 S", -131),
        ("POW:ACH:BWID UP", -141),
        ("POW:ACH:BWID? 1", -128),
        ("POW:ACH:ACP 13", -222),
        ("POW:ACH:TXCH:COUN 2", -222),
        ("POW:BWID 99 HZ", -131),
        ("POW:ACH:MODE 1", -128),
        ("CALC:MARK17:Y?", -114),
        ("CALC:MARK:Y?", -221),
        ("CALC:MARK:X?", -221),
        ("CALC:MARK:X 2 GHZ", -222),
        ("CALC:MARK:X UP", -141),
        ("CALC:MARK:FUNC:BPOW:SPAN 0", -222),
        ("CALC:MARK:FUNC:BPOW:SPAN MAX", -141),
        ("CALC:MARK:FUNC:BPOW:MODE RPOW", -141),
        ("LIST:POW:RES?", -230),
        ("LIST:POW:SET OFF,OFF,OFF,IMM,POS,0", -109),
        ("LIST:POW:SET OFF,OFF,OFF,EXT,POS,0,0", -141),
        ("LIST:POW:SET OFF,OFF,OFF,IMM,POS,MIN,0", -141),
        ("LIST:POW? 1e9,-20,0,NORM,1e6,1e6,0.001", -109),
        ("LIST:POW? 1e9,-20,0,NORM,1e6,1e6,0.001,0,5", -109),
        ("LIST:POW? 1e9,-20,0,NORM,1e6,1e6,1e9,0", -222),
        ("LIST:POW? 99e9,-20,0,NORM,1e6,1e6,0.1,0", -222),
        ("LIST:POW? 1e9,-20,0,GAUSS,1e6,1e6,0.1,0", -141),
        ("LIST:POW? 1e9 S,-20,0,NORM,1e6,1e6,0.1,0", -131),
        ("LIST:POW? 'a',-20,0,NORM,1e6,1e6,0.1,0", -158),
        ("LIST:POW? MAX,-20,0,NORM,1e6,1e6,0.1,0", -141),
        ("LIST:POW:STAT ON", -224),
        ("LIST:POW:SET OFF,OFF,OFF,IMM,POS,0,0;:LIST:POW? 1e9,-20,0,NORM,1e6,1e6,0.1,0", -221),
    ],
)
def test_wrong_unit_queues_its_error_and_answers_nothing(swept: Any, message: str, code: int) -> None:
    assert swept.ask(message) == ""
    assert swept.errors() == [code]


@pytest.mark.parametrize("query", [f"{POWER}:RES? CPOW", f"{POWER}:RES? OBW", "FETC:POW:ACP?", "CALC:MARK:MAX"])
def test_functions_need_a_trace_over_frequency(bench: Any, query: str) -> None:
    bench.ask("INIT:CONT OFF")
    assert bench.ask(query) == ""
    assert bench.errors() == [-230]
    bench.ask("FREQ:SPAN 0;:INIT")
    assert bench.ask(query) == ""
    assert bench.errors() == [-221]


def test_value_out_of_range_is_stored_at_its_limit(bench: Any) -> None:
    assert bench.ask("POW:ACH:BWID 1e12;BWID?;BWID? MIN;BWID? DEF;BWID MIN;BWID?") == "1000000000;100;14000;100"
    assert bench.errors() == [-222]


def test_reset_forgets_all_functions(swept: Any) -> None:
    swept.ask("POW:ACH:BWID 5 MHZ;MODE ABS;:CALC:MARK2:X 1 GHZ;:CALC:MARK:PEXC 9;:LIST:POW:SET ON,OFF,OFF,IMM,POS,0,0")
    assert swept.ask("*RST;:POW:ACH:BWID?;MODE?;:CALC:MARK2?;:CALC:MARK:PEXC?") == "14000;REL;0;6"
    assert swept.ask("LIST:POW:SET?") == "0,1,0,IMM,POS,0,0"


def test_adjusting_to_the_channels_shows_them_all(bench: Any) -> None:
    bench.ask(
        "INIT:CONT OFF;:FREQ:CENT 1017 MHZ;:POW:ACH:BWID 2.5 MHZ;ACP 1;SPAC 5 MHZ;BWID:ACH 1 MHZ;:POW:ACH:PRES ACP"
    )
    assert bench.ask("FREQ:SPAN?;:BAND?;:DET?") == "13200000;50000;RMS"
    assert "9.91E37" not in bench.ask(f"INIT;:{POWER}:RES? ACP")
