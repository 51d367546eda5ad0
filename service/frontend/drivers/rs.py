"""Rohde & Schwarz FSV, FSW and their kin.

Real numbers come little-endian and there is no ``FORM:BORD``; digital Gaussian filters with ENBW = 1.0645 RBW.
"""

from service.core.radio.predicted_sigma import GAUSSIAN_ENBW_RATIO
from service.frontend.drivers.base import Dialect

RS = Dialect(
    name="rs",
    vendor="rohde",
    binary_format="REAL,32",
    is_big_endian=False,
    trace_query=":TRAC? TRACE1",
    reference_level=":DISP:TRAC:Y:RLEV",
    attenuation=":INP:ATT",
    preamplifier=":INP:GAIN:STAT",
    enbw_ratio=GAUSSIAN_ENBW_RATIO,
)
