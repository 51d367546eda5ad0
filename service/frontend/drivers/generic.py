"""Any analyzer that follows SCPI: traces as ASCII, because the byte order of its blocks is not known."""

from service.core.radio.predicted_sigma import GAUSSIAN_ENBW_RATIO
from service.frontend.drivers.base import Dialect

GENERIC = Dialect(
    name="generic",
    vendor="",
    binary_format="",
    is_big_endian=False,
    trace_query=":TRAC:DATA? TRACE1",
    reference_level=":DISP:WIND:TRAC:Y:SCAL:RLEV",
    attenuation=":POW:ATT",
    preamplifier=":POW:GAIN:STAT",
    enbw_ratio=GAUSSIAN_ENBW_RATIO,
)
