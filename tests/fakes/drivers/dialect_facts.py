"""What the analyzer specification says of each maker's language, written by hand; tests know it from nowhere else."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Facts:
    """One maker."""

    #: pattern of the answer to ``*IDN?``
    identity: str
    #: units that choose the power average of noise, and what the detector query answers then
    power_detector: str
    detector_query: str
    detector_answer: str
    #: query of the first trace
    trace_query: str
    #: choice of 32 bit blocks, and their byte order after ``*RST``
    real32: str
    is_big_endian: bool
    #: units of a short sweep of few points, and how many it has
    few_points: str
    points: int
    points_query: str
    #: attenuation, by the header of the maker
    attenuation: str
    #: a bandwidth asked for and the step it becomes
    rbw_asked_hz: float
    rbw_step_hz: float
    #: span over RBW, RBW over VBW, by coupling
    span_per_rbw: float
    #: state of ``INIT:CONT`` after ``*RST`` and after ``SYST:PRES``
    is_continuous_after_reset: bool
    is_continuous_after_preset: bool
    #: header with a numeric suffix beyond what exists
    suffix_beyond: str
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
        power_detector="DET RMS",
        detector_query="DET?",
        detector_answer="RMS",
        trace_query="TRAC? TRACE1",
        real32="FORM REAL,32",
        is_big_endian=False,
        few_points="SWE:POIN 101",
        points=101,
        points_query="SWE:POIN?",
        attenuation="INP:ATT",
        rbw_asked_hz=29e3,
        rbw_step_hz=30e3,
        span_per_rbw=100.0,
        is_continuous_after_reset=True,
        is_continuous_after_preset=True,
        suffix_beyond="SENS9:FREQ:CENT?",
    ),
    "keysight": Facts(
        identity=r"Keysight Technologies,N9020B,MY\d+,A\.30\.05",
        power_detector="DET AVER;:AVER:TYPE RMS",
        detector_query="DET?",
        detector_answer="AVER",
        trace_query="TRAC? TRACE1",
        real32="FORM REAL,32",
        is_big_endian=True,
        few_points="SWE:POIN 101",
        points=101,
        points_query="SWE:POIN?",
        attenuation="POW:ATT",
        rbw_asked_hz=29e3,
        rbw_step_hz=30e3,
        span_per_rbw=106.0,
        is_continuous_after_reset=False,
        is_continuous_after_preset=True,
        suffix_beyond="TRAC9:TYPE?",
        no_error='+0,"No error"',
        uncalibrated=1 << 9,  # INTegrity, as X series have it
    ),
    "siglent": Facts(
        identity=r"Siglent Technologies,SSA3032X,SSA3X[^,]*,1\.2\.9\.3",
        power_detector="DET:TRAC AVER;:AVER:TYPE POW",
        detector_query="DET:TRAC?",
        detector_answer="AVER",
        trace_query="TRAC:DATA? 1",
        real32="FORM REAL",
        is_big_endian=False,
        few_points="SWE:POIN 101",
        points=751,
        points_query="SWE:POIN?",
        attenuation="POW:ATT",
        rbw_asked_hz=65e3,
        rbw_step_hz=100e3,
        span_per_rbw=100.0,
        is_continuous_after_reset=True,
        is_continuous_after_preset=True,
        suffix_beyond="TRAC9:MODE?",
        has_trailing_comma=True,
    ),
    "anritsu": Facts(
        identity=r"Anritsu,MS2090A,[^,]+,[^,]+",
        power_detector="DET RMS",
        detector_query="DET?",
        detector_answer="RMS",
        trace_query="TRAC:DATA? 1",
        real32="FORM REAL,32",
        is_big_endian=False,
        few_points="DISP:POIN 101",
        points=101,
        points_query="DISP:POIN?",
        attenuation="POW:RF:ATT",
        rbw_asked_hz=29e3,
        rbw_step_hz=30e3,
        span_per_rbw=300.0,
        is_continuous_after_reset=True,
        is_continuous_after_preset=True,
        suffix_beyond="TRAC99:TYPE?",
        has_ascii_header=True,
        no_trace="#0",
    ),
}
