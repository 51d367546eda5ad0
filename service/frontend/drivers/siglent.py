"""Siglent SSA3000X and SVA1000X, and the instruments of other names that are built alike.

Drivers in use ask ``TRAC:SWE:STAT?`` for the end of a sweep, so ``*OPC?`` alone is not trusted. Older firmware sweeps
751 points whatever it is told; the trace itself says how many there are. Text ends with a comma. The byte order of its
blocks is not documented, and 751 numbers as text cost a millisecond.
"""

from service.frontend.drivers.base import ASCII, UNIT, Dialect, Word

SIGLENT = Dialect(
    name="siglent",
    identity=r"^(siglent|teledyne\s*test|lecroy)|,(ssa|sva|t3sa)\d",
    detectors=((Word(":DET:TRAC1", "AVER", "AVERAGE"), Word(":AVER:TYPE", "POW", "POWER")),),
    method=(
        UNIT,
        Word(":TRAC1:MODE", "WRIT", "WRITE"),
        Word(":SWE:MODE", "SWE", "SWEEP", is_needed=False),
        Word(":FILT:TYPE", "GAUSS", is_needed=False),
    ),
    formats=(ASCII,),
    trace_query=":TRAC:DATA? 1",
    points=":SWE:POIN",
    reference_level=":DISP:WIND:TRAC:Y:RLEV",
    attenuation=":POW:ATT",
    preamplifier=":POW:GAIN",
    fixed_points=751,
    sweep_end=":TRAC:SWE:STAT? 1",
    local="",
)
