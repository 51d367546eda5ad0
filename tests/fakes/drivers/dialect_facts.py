"""What the analyzer specification says of each maker's language, written by hand; tests know it from nowhere else."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Facts:
    """One maker; a default is what most of them have."""

    #: pattern of the answer to ``*IDN?``
    identity: str
    #: attenuation, by the header of the maker
    attenuation: str
    #: header with a numeric suffix beyond what exists
    suffix_beyond: str
    #: units that choose the power average of noise
    power_detector: str = "DET RMS"
    #: query of the first trace
    trace_query: str = "TRAC:DATA? 1"
    #: choice of 32 bit blocks, and their byte order after ``*RST``
    real32: str = "FORM REAL,32"
    is_big_endian: bool = False
    #: units of a short sweep of few points, and how many it has
    few_points: str = "SWE:POIN 101"
    points: int = 101
    #: a bandwidth asked for and the step it becomes
    rbw_asked_hz: float = 29e3
    rbw_step_hz: float = 30e3
    #: span over RBW, RBW over VBW, by coupling
    span_per_rbw: float = 100.0
    #: state of ``INIT:CONT`` after ``*RST`` and after ``SYST:PRES``
    is_continuous_after_reset: bool = True
    is_continuous_after_preset: bool = True
    no_error: str = '0,"No error"'
    #: least and largest depth of the error queue
    queue_depths: tuple[int, int] = (20, 30)
    #: bit of QUEStionable:CONDition when a sweep is too fast
    uncalibrated: int = 1 << 8
    #: an ASCII trace ends with a comma
    has_trailing_comma: bool = False
    #: an ASCII trace stands in a definite length block
    has_ascii_header: bool = False
    #: what the query of a trace answers when there is none
    no_trace: str = ""


FACTS = {
    "rs": Facts(
        identity=r"Rohde&Schwarz,FSW-26,[^,]+/[^,]+,[^,]+",
        trace_query="TRAC? TRACE1",
        attenuation="INP:ATT",
        suffix_beyond="SENS9:FREQ:CENT?",
    ),
    "keysight": Facts(
        identity=r"Keysight Technologies,N9020B,MY\d+,A\.30\.05",
        power_detector="DET AVER;:AVER:TYPE RMS",
        trace_query="TRAC? TRACE1",
        is_big_endian=True,
        attenuation="POW:ATT",
        span_per_rbw=106.0,
        is_continuous_after_reset=False,
        suffix_beyond="TRAC9:TYPE?",
        no_error='+0,"No error"',
        uncalibrated=1 << 9,  # INTegrity, as X series have it
    ),
    "siglent": Facts(
        identity=r"Siglent Technologies,SSA3032X,SSA3X[^,]*,1\.2\.9\.3",
        power_detector="DET:TRAC AVER;:AVER:TYPE POW",
        real32="FORM REAL",
        points=751,
        attenuation="POW:ATT",
        rbw_asked_hz=65e3,
        rbw_step_hz=100e3,
        suffix_beyond="TRAC9:MODE?",
        has_trailing_comma=True,
    ),
    "anritsu": Facts(
        identity=r"Anritsu,MS2090A,[^,]+,[^,]+",
        few_points="DISP:POIN 101",
        attenuation="POW:RF:ATT",
        span_per_rbw=300.0,
        suffix_beyond="TRAC99:TYPE?",
        has_ascii_header=True,
        no_trace="#0",
    ),
}
