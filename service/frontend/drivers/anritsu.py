"""Anritsu MS2090A, MS27xxT and S-series hand-helds.

A trace comes with a block header before its text too, and as ``#0`` while there is none. Points are a setting of the
display.
"""

from service.frontend.drivers.base import ASCII, UNIT, Dialect, Word

ANRITSU = Dialect(
    name="anritsu",
    identity=r"^anritsu",
    detectors=((Word(":DET", "RMS"),),),
    method=(
        UNIT,
        Word(":TRAC1:TYPE", "NORM", "NORMAL|WRIT|WRITE", is_needed=False),
        Word(":AVER:TYPE", "NONE", is_needed=False),
    ),
    formats=(ASCII,),
    trace_query=":TRAC:DATA? 1",
    points=":DISP:POIN",
    reference_level=":DISP:WIND:TRAC:Y:SCAL:RLEV",
    attenuation=":POW:RF:ATT",
    preamplifier=":POW:RF:GAIN:STAT",
    local="",
)
