"""Any analyzer that follows SCPI: traces as text, because the byte order of its blocks is not known.

Three ways of asking for the mean of powers are tried; an analyzer that takes none of them, or that does not say that
its unit is dBm, is refused: its levels could not be told from wrong ones.
"""

from service.frontend.drivers.base import ASCII, UNIT, Dialect, Word

GENERIC = Dialect(
    name="generic",
    identity="",
    detectors=(
        (Word(":DET", "RMS"),),
        (Word(":DET", "AVER", "AVERAGE"), Word(":AVER:TYPE", "RMS")),
        (Word(":DET", "AVER", "AVERAGE"), Word(":AVER:TYPE", "POW", "POWER")),
    ),
    method=(UNIT,),
    formats=(ASCII,),
    trace_query=":TRAC:DATA? TRACE1",
    points=":SWE:POIN",
    reference_level=":DISP:WIND:TRAC:Y:SCAL:RLEV",
    attenuation=":POW:ATT",
    preamplifier=":POW:GAIN:STAT",
    local="",
)
