"""Rohde & Schwarz FSV, FSVA, FSW, FPS, FSL and their kin.

Real numbers come little-endian and there is no ``FORM:BORD``; digital Gaussian filters with ENBW = 1.0645 RBW.
"""

from service.frontend.drivers.base import ASCII, UNIT, Dialect, TraceFormat, Word

RS = Dialect(
    name="rs",
    identity=r"^(rohde|r\s*&\s*s\b|hameg)",
    detectors=((Word(":DET", "RMS"),),),
    method=(
        UNIT,
        Word(":DISP:TRAC:MODE", "WRIT", "WRITE"),
        Word(":BAND:TYPE", "NORM", "NORMAL", is_needed=False),
        Word(":SWE:TYPE", "SWE", "SWEEP", is_needed=False),
        Word(":SWE:COUN", "1", is_needed=False),
    ),
    formats=(TraceFormat((Word(":FORM", "REAL,32"),), is_binary=True), ASCII),
    trace_query=":TRAC? TRACE1",
    points=":SWE:POIN",
    reference_level=":DISP:TRAC:Y:RLEV",
    attenuation=":INP:ATT",
    preamplifier=":INP:GAIN:STAT",
    application=Word(":INST", "SAN", "SANALYZER", is_needed=False),
)
