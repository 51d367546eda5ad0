"""Keysight X series (N9000B CXA to N9041B UXA), and the Agilent and Hewlett-Packard instruments that speak like them.

The detector ``AVERage`` is the mean of powers only while ``AVER:TYPE`` is RMS; its preset is a mean of decibels,
2.51 dB low. Real numbers come big-endian unless told otherwise, so the order is stated. Uncalibrated sweeps stand in
the integrity bit.
"""

from service.frontend.drivers.base import ASCII, UNIT, Dialect, TraceFormat, Word

KEYSIGHT = Dialect(
    name="keysight",
    identity=r"^(keysight|agilent|hewlett|hp\b)",
    detectors=((Word(":DET:TRAC", "AVER", "AVERAGE"), Word(":AVER:TYPE", "RMS")),),
    method=(
        UNIT,
        Word(":TRAC:TYPE", "WRIT", "WRITE"),
        Word(":BAND:TYPE", "DB3", is_needed=False),
        Word(":SWE:TYPE", "SWE", "SWEEP", is_needed=False),
    ),
    formats=(
        TraceFormat(
            (Word(":FORM:BORD", "NORM", "NORMAL"), Word(":FORM", "REAL,32", r"REAL,\+?32")),
            is_binary=True,
            is_big_endian=True,
        ),
        ASCII,
    ),
    trace_query=":TRAC? TRACE1",
    points=":SWE:POIN",
    reference_level=":DISP:WIND:TRAC:Y:RLEV",
    attenuation=":POW:ATT",
    preamplifier=":POW:GAIN",
    application=Word(":INST", "SA", is_needed=False),
    calibration_bits=(1 << 8) | (1 << 9),
    local="",
)
