"""Siglent SSA3000X.

Where this differs from R&S: 751 points whatever is asked; filter steps 1-3-10, nearest on a linear scale; the detector
AVERage takes its kind of mean from ``AVERage:TYPE``; an ASCII trace ends with a comma; traces are numbered; the end of
a sweep is polled with ``TRACe:SWEep:STATe?``. ``MEASure:CHPower`` answers from the trace there is; a sweep is taken
first only when the settings have changed since and the instrument does not sweep without end [K].
"""

from analyzer_sim.dialects import settings_rows as rows
from analyzer_sim.dialects import sweep_rows as sweeps
from analyzer_sim.dialects.dialect import Call, Command, Dialect, TraceFormat, TraceStyle
from analyzer_sim.instrument.instrument_settings import SSA3032X
from analyzer_sim.scpi.errors import ScpiError
from analyzer_sim.scpi.parameters import DECIBELS, PURE, Choice, Numeric, TraceName

IDENTITY = "Siglent Technologies,SSA3032X,SSA3XLBD2R0101,1.2.9.3"
_DETECTORS = {
    "NEGative": "NEG",
    "POSitive": "POS",
    "SAMPle": "SAMP",
    "AVERage": sweeps.BY_TYPE,
    "NORMal": "APE",
    "QUASi": "QPE",
}
#: filters for interference are told by their width at 6 dB
_FILTER_TYPES = {"GAUSS": 1.0, "EMI": sweeps.DB6_RATIO}
_AVERAGE_TYPES = {"LOGPower": "VID", "POWer": "POW", "VOLTage": "LIN"}
_UNITS = ("DBM", "DBMV", "DBUV", "DBUA", "V", "W")
_TRACE_NAME = TraceName(("TRC", "TRACE", "TRAC"), 4)
#: little-endian; ``FORMat?`` answers the long word
TRACE_STYLE = TraceStyle(
    (TraceFormat("ASCii", 0, "ASCii", "ASC"), TraceFormat("REAL", 32, "REAL", "REAL,32")), ascii_end=","
)

_SENSE = "[SENSe]"
_BANDWIDTH = f"{_SENSE}:BANDwidth|BWIDth"
_TRACE_Y = "DISPlay:WINDow[:TRACe<4>]:Y[:SCALe]"
_POWER = f"{_SENSE}:POWer[:RF]"


def _is_swept(call: Call, number: int | float | str = 1) -> str:  # noqa: ARG001 - all traces are swept together
    return str(int(not call.instrument.is_pending))


def _clear_average(call: Call) -> None:
    call.instrument.invalidate()


def _sweep_if_stale(call: Call) -> None:
    """Start a single sweep unless there is a trace with the present settings."""
    if call.instrument.settings.is_continuous:
        return
    try:
        call.instrument.trace()
    except ScpiError:
        rows.start_sweep(call)


def _widen_to_span(call: Call) -> None:
    limits = SSA3032X.channel_width_hz
    call.instrument.channel.width_hz = min(max(call.instrument.settings.span_hz, limits.low), limits.high)


def _select_measurement(call: Call, name: str) -> None:
    call.instrument.channel.is_selected = name == "CHP"


_FREQUENCY_ROWS = (
    *rows.frequency_rows(f"{_SENSE}:FREQuency", "CENTer:STEP[:INCRement]"),
    rows.step_auto_row(f"{_SENSE}:FREQuency:CENTer:STEP:AUTO"),
    rows.span_row(f"{_SENSE}:FREQuency:SPAN:PREVious", lambda settings: settings.previous_span_hz),
    rows.span_row(f"{_SENSE}:FREQuency:SPAN:HALF", lambda settings: 0.5 * settings.span_hz),
    rows.span_row(f"{_SENSE}:FREQuency:SPAN:DOUBle", lambda settings: 2.0 * settings.span_hz),
    rows.span_row(f"{_SENSE}:FREQuency:SPAN:ZERO", lambda _settings: 0.0),
)

_BANDWIDTH_ROWS = (
    *rows.bandwidth_rows(_BANDWIDTH),
    sweeps.filter_type_row(f"{_SENSE}:FILTer:TYPE", _FILTER_TYPES),
)

_SWEEP_ROWS = (
    rows.numeric(f"{_SENSE}:SWEep:POINts", "points"),
    *rows.sweep_time_rows(f"{_SENSE}:SWEep"),
    rows.choice(f"{_SENSE}:SWEep:MODE", "sweep_type", ("AUTO", "FFT", "SWEep")),
    rows.inert(f"{_SENSE}:SWEep:SPEed", "NORM", ("NORMal", "ACCUracy")),
    rows.numeric(f"{_SENSE}:SWEep:COUNt", "count"),
    *sweeps.detector_rows(
        f"{_SENSE}:DETector[:TRACe<4>][:FUNCtion]", f"{_SENSE}:DETector[:TRACe<4>][:FUNCtion]:AUTO", _DETECTORS
    ),
    rows.numeric(f"{_SENSE}:AVERage[:TRACe<4>]:COUNt", "average_count"),
    Command(f"{_SENSE}:AVERage[:TRACe<4>]:CLEar", _clear_average),
    sweeps.average_type_row(f"{_SENSE}:AVERage:TYPE", _AVERAGE_TYPES, does_detector_follow=True),
    sweeps.trace_mode_row("TRACe<4>:MODE", "WRITe"),
    sweeps.initiate_row("INITiate[:IMMediate]"),
    sweeps.continuous_row("INITiate:CONTinuous"),
    rows.inert("TRIGger[:SEQuence]:SOURce", "IMM", ("IMMediate",)),
    Command("TRACe:SWEep:STATe", query=_is_swept, query_parameters=(Numeric(PURE),)),
)

_LEVEL_ROWS = (
    *rows.level_rows(_TRACE_Y, f"{_POWER}:ATTenuation", f"{_POWER}:GAIN[:STATe]"),
    rows.inert_number(f"{_TRACE_Y}:PDIVision", 10.0, 1.0, 10.0, DECIBELS),
    rows.inert(f"{_TRACE_Y}:SPACing", "LOG", ("LOGarithmic", "LINear")),
    rows.constant(f"{_SENSE}:CORRection:IMPedance", "OHM50"),
    sweeps.unit_row("UNIT:POWer", _UNITS),
)

_TRACE_ROWS = (
    rows.format_row("FORMat[:TRACe][:DATA]", TRACE_STYLE),
    rows.trace_row("TRACe<4>[:DATA]", TRACE_STYLE, _TRACE_NAME),
)

_CHANNEL_POWER_ROWS = (
    Command(
        "INSTrument:MEASure",
        _select_measurement,
        lambda call: "CHP" if call.instrument.channel.is_selected else "OFF",
        (Choice(("OFF", "CHPower")),),
    ),
    rows.channel_row(f"{_SENSE}:CHPower:BWIDth|BANDwidth:INTegration", "width_hz", SSA3032X.channel_width_hz),
    Command(f"{_SENSE}:CHPower:FREQuency:SPAN:POWer", _widen_to_span),
    *rows.channel_power_rows(
        "MEASure:CHPower", lambda call, which: rows.results_text(rows.channel_power(call)[which]), _sweep_if_stale
    ),
)

_MISCELLANEOUS_ROWS = (
    rows.constant("*IDN", IDENTITY),
    rows.constant("*OPT", "0"),
    sweeps.application_row("INSTrument[:SELect]", "SA", frozenset({"SA"})),
    *sweeps.LOCAL_ROWS,
)

SIGLENT = Dialect(
    name="siglent",
    identity=IDENTITY,
    model=SSA3032X,
    own_noise_dbm_hz=-145.0,
    deviations=(
        "Filters for interference (`FILTer:TYPE EMI`) have the steps of the others, told by their width at 6 dB.",
    ),
    traces=TRACE_STYLE,
    units=_UNITS,
    commands=(
        *sweeps.COMMON_COMMANDS,
        *sweeps.SYSTEM_COMMANDS,
        *_FREQUENCY_ROWS,
        *_BANDWIDTH_ROWS,
        *_SWEEP_ROWS,
        *_LEVEL_ROWS,
        *_TRACE_ROWS,
        *_CHANNEL_POWER_ROWS,
        *_MISCELLANEOUS_ROWS,
    ),
)
