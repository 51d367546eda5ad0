"""Which data element fits which kind of parameter."""

import math

import pytest

from analyzer_sim.scpi.errors import ScpiError
from analyzer_sim.scpi.parameters import (
    HERTZ,
    PURE,
    SECONDS,
    Boolean,
    Choice,
    Level,
    Numeric,
    Parameter,
    Quoted,
    TraceName,
)
from analyzer_sim.scpi.parser import parse_data

TRACE = TraceName(("TRC",), 4)
DETECTOR = Choice(("RMS", "POSitive"))


@pytest.mark.parametrize(
    ("parameter", "text", "value"),
    [
        (Numeric(HERTZ), "1 MHZ", 1e6),
        (Numeric(HERTZ), "1 mhz", 1e6),
        (Numeric(HERTZ), "2.5GHZ", 2.5e9),
        (Numeric(SECONDS), "20 MS", 0.02),
        (Numeric(SECONDS), "5 us", 5e-6),
        (Numeric(PURE), "#HFF", 255.0),
        (Numeric(HERTZ), "MAXIMUM", "MAX"),
        (Numeric(HERTZ), "up", "UP"),
        (Numeric(HERTZ), "INF", math.inf),
        (Numeric(HERTZ), "NINF", -math.inf),
        (Boolean(), "ON", True),
        (Boolean(), "off", False),
        (Boolean(), "0.4", False),
        (Boolean(), "-3", True),
        (DETECTOR, "positive", "POS"),
        (DETECTOR, "POS", "POS"),
        (Quoted(), "'Spectrum'", "Spectrum"),
        (Level(), "-30", -30.0),
        (Level(), "-30 DBM", -30.0),
        (Level(), "MIN", "MIN"),
        (Level(), "1 W", 30.0),
        (Level(), "0 W", -math.inf),
        (Level(), "2 MW", 10.0 * math.log10(2.0)),
        (Level(), "60 DBPW", -30.0),
        (Level(), "1 V", 10.0 * math.log10(20.0)),
        (Level(), "1000 MV", 10.0 * math.log10(20.0)),
        (Level(), "120 DBUV", 10.0 * math.log10(20.0)),
        (TRACE, "1", 1),
        (TRACE, "trc4", 4),
        (Quoted(), "SAN", "SAN"),
    ],
)
def test_fitting_element_gives_its_value(parameter: Parameter, text: str, value: object) -> None:
    read = parameter.read(parse_data(text)[0])
    assert read == pytest.approx(value, rel=1e-15) if isinstance(value, float) else read == value


@pytest.mark.parametrize(
    ("parameter", "text", "code"),
    [
        (Numeric(HERTZ), "1 S", -131),
        (Numeric(PURE), "1 HZ", -138),
        (Numeric(HERTZ), "FOO", -141),
        (Numeric(HERTZ), "'1'", -158),
        (Numeric(HERTZ), "#11a", -168),
        (Boolean(), "MAYBE", -141),
        (Boolean(), "1 HZ", -138),
        (Boolean(), "'ON'", -158),
        (DETECTOR, "1", -128),
        (DETECTOR, "POSI", -141),
        (DETECTOR, "'RMS'", -158),
        (Quoted(), "1", -128),
        (Level(), "1 HZ", -131),
        (Level(), "'1'", -158),
        (TRACE, "5", -224),
        (TRACE, "1.5", -224),
        (TRACE, "TRC5", -141),
        (TRACE, "TRC", -141),
        (TRACE, "1 DB", -138),
        (TRACE, "'TRC1'", -158),
        (TraceName(("TRACE",), 6, is_number_legal=False), "1", -128),
        (Quoted(), "#11a", -168),
    ],
)
def test_other_element_has_its_error(parameter: Parameter, text: str, code: int) -> None:
    with pytest.raises(ScpiError) as caught:
        parameter.read(parse_data(text)[0])
    assert caught.value.code == code
