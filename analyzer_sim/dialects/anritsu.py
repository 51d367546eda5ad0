"""Anritsu MS2090A, Spectrum Analyzer application, and what it shares with MS27xxT and MS20xxC.

Where this differs from R&S: the points are those of the display (``DISPlay:POINtcount``); a trace stands in a block of
definite length in every format, ASCII too, and ``#0`` stands for one that is not valid; ``TRACe:PREamble?`` tells how
it was taken; blocks are little-endian, integers in milli-dBm; filter steps 1-3-10.

Channel power: CONFigure selects it, RMS detector, single sweep, a channel as wide as the span; FETCh? answers from the
trace there is, READ? sweeps first, MEASure? is CONFigure and READ?. A result that does not exist is -999.0; without a
trace both are.
"""

from dataclasses import replace

from analyzer_sim.dialects import settings_rows as rows
from analyzer_sim.dialects import sweep_rows as sweeps
from analyzer_sim.dialects.dialect import Call, Command, Dialect, TraceFormat, TraceStyle
from analyzer_sim.epochs import rfc3339
from analyzer_sim.instrument.instrument_settings import MS2090A, Settings
from analyzer_sim.instrument.levels import definite_block
from analyzer_sim.instrument.quantities import load
from analyzer_sim.scpi.errors import ScpiError
from analyzer_sim.scpi.parameters import DECIBELS, HERTZ, Choice, TraceName

IDENTITY = "Anritsu,MS2090A,2014005,V2023.3.1"
_DETECTORS = {"POSitive": "POS", "RMS": "RMS", "NEGative": "NEG", "SAMPle": "SAMP", "QUASi": "QPE"}
_UNITS = ("DBM", "DBV", "DBMV", "DBUV", "V", "W")
_TRACE_NAME = TraceName(("TRACE",), 6)
TRACE_STYLE = TraceStyle(
    (
        TraceFormat("ASCii", 0, "ASC,0", "ASC"),
        TraceFormat("INTeger", 32, "INT,32", "INT,32"),
        TraceFormat("REAL", 64, "REAL,64", "REAL,64"),
        TraceFormat("REAL", 32, "REAL,32", "REAL,32"),
    ),
    is_ascii_in_block=True,
    invalid=b"#0",
)

_SENSE = "[SENSe]"
_BANDWIDTH = f"{_SENSE}:BANDwidth|BWIDth"
_TRACE_Y = "DISPlay:WINDow[:TRACe]:Y[:SCALe]"
_POWER = f"{_SENSE}:POWer[:RF]"
_NO_FIX = "NO FIX"
_NO_RESULT = "-999.0"


_AVERAGE_WORDS = ("NONE", "SCALar", "MAXimum", "MINimum")
#: word of ``AVERage:TYPE`` -> whether several sweeps are taken, and what is held of them
_AVERAGE_TYPES = {"NONE": (False, ""), "SCAL": (True, ""), "MAX": (True, "MAXH"), "MIN": (True, "MINH")}


def _put_average_type(call: Call, word: str) -> None:
    call.instrument.settings.is_averaging, call.instrument.settings.hold = _AVERAGE_TYPES[word]
    call.instrument.invalidate()


def _average_type(call: Call) -> str:
    settings = call.instrument.settings
    state = (True, settings.hold) if settings.is_averaging else (False, "")
    return next(word for word, of_word in _AVERAGE_TYPES.items() if of_word == state)


def _megahertz(value_hz: float) -> str:
    return f"{1e-6 * value_hz:.6f} MHZ"


def _coupling(is_auto: bool) -> str:  # noqa: FBT001 - the one thing it tells
    return "AUTO" if is_auto else "MANUAL"


def _preamble_fields(settings: Settings) -> dict[str, str]:
    """Return the parameters of the trace header that describe the sweep."""
    return {
        "UNITS": settings.unit,
        "START_FREQ": _megahertz(load(settings, "start_hz")),
        "STOP_FREQ": _megahertz(load(settings, "stop_hz")),
        "CENTER_FREQ": _megahertz(load(settings, "center_hz")),
        "SPAN": _megahertz(settings.span_hz),
        "FREQ_STEP": _megahertz(settings.step_hz),
        "RBW": _megahertz(settings.rbw_shown_hz),
        "RBW_TYPE": _coupling(settings.is_rbw_auto),
        "VBW": _megahertz(settings.vbw_hz),
        "VBW_TYPE": _coupling(settings.is_vbw_auto),
        "INPUT_ATTEN": f"{settings.attenuation_db:.1f} dB",
        "ATTEN_TYPE": _coupling(settings.is_attenuation_auto),
        "REFERENCE_LEVEL": f"{load(settings, 'reference_dbm'):.2f} dBm",
        "PREAMP_SET": "ON" if settings.is_preamplifier_on else "OFF",
        "DETECTION": settings.detector,
        "TRACE_AVERAGE": str(settings.average_count),
        "SWEEP_TYPE": "CONTINUOUS" if settings.is_continuous else "SINGLE",
        "TRACE_MODE": (settings.hold or "AVERAGE") if settings.is_averaging else "NORMAL",
        "UI_DATA_POINTS": str(settings.points),
        "SET_SWEEP_TIME": f"{rows.number_text(settings.time_s)} S",
    }


def _preamble(call: Call, number: int = 1) -> bytes:  # noqa: ARG001 - the traces are taken with the same settings
    model, serial, version = IDENTITY.split(",")[1:]
    fields = {
        "SN": serial,
        "UNIT_NAME": model,
        "DATE": rfc3339(call.instrument.epoch_us())[:19],
        "BASE_VER": version,
        "APP_NAME": "SPA",
        **_preamble_fields(call.instrument.settings),
    }
    return definite_block(",".join(f"{name}={value}" for name, value in fields.items()).encode("ascii"))


def _configure_channel_power(call: Call) -> None:
    settings = call.instrument.settings
    rows.reset_channel(call).is_selected = True
    settings.detector, settings.is_detector_auto = "RMS", False
    settings.is_continuous = False
    call.instrument.abort()
    call.instrument.invalidate()


def _measure_channel_power(call: Call) -> None:
    _configure_channel_power(call)
    rows.start_sweep(call)


def _channel_results(call: Call, which: slice) -> str:
    try:
        return rows.results_text(rows.channel_power(call)[which], _NO_RESULT)
    except ScpiError:
        return ",".join([_NO_RESULT] * (which.stop - which.start))


#: a width that was not set is answered as the span
_CHANNEL_WIDTH_ROW = replace(
    rows.channel_row(f"{_SENSE}:CHPower:BANDwidth|BWIDth:INTegration", "width_hz", MS2090A.channel_width_hz),
    query=lambda call: rows.number_text(call.instrument.channel.width_hz or call.instrument.settings.span_hz),
    query_parameters=(),
)

_FREQUENCY_ROWS = (
    *rows.frequency_rows(f"{_SENSE}:FREQuency", "STEP[:INCRement]"),
    rows.span_row(f"{_SENSE}:FREQuency:SPAN:LAST|PREVious", lambda settings: settings.previous_span_hz),
)

_BANDWIDTH_ROWS = (
    *rows.bandwidth_rows(_BANDWIDTH),
    rows.numeric(f"{_BANDWIDTH}[:RESolution]:RATio", "rbw_per_span"),
    rows.inert(f"{_BANDWIDTH}:VIDeo:TYPE", "LIN", ("LINear", "LOGarithmic")),
)

_SWEEP_ROWS = (
    rows.numeric("DISPlay:POINtcount", "points"),
    *rows.sweep_time_rows(f"{_SENSE}:SWEep"),
    *sweeps.detector_rows(f"{_SENSE}:DETector[:FUNCtion]", f"{_SENSE}:DETector[:FUNCtion]:AUTO", _DETECTORS),
    rows.numeric(f"{_SENSE}:AVERage:COUNt", "average_count"),
    Command(f"{_SENSE}:AVERage:TYPE", _put_average_type, _average_type, (Choice(_AVERAGE_WORDS),)),
    sweeps.trace_mode_row("TRACe<6>:TYPE", "NORMal"),
    sweeps.trace_mode_row("TRACe<6>:OPERation", "NORMal"),
    sweeps.initiate_row("INITiate[:IMMediate]"),
    sweeps.initiate_row("INITiate:ALL"),
    sweeps.continuous_row("INITiate:CONTinuous"),
    rows.inert("TRIGger[:SEQuence]:SOURce", "IMM", ("IMMediate",)),
)

_LEVEL_ROWS = (
    *rows.level_rows(_TRACE_Y, f"{_POWER}:ATTenuation", f"{_POWER}:GAIN[:STATe]"),
    rows.inert_number(f"{_TRACE_Y}:PDIVision", 10.0, 1.0, 15.0, DECIBELS),
    rows.constant(f"{_SENSE}:CORRection:IMPedance[:INPut][:MAGNitude]", "50"),
    sweeps.unit_row("UNIT:POWer", _UNITS),
)

_TRACE_ROWS = (
    rows.format_row("FORMat[:READings][:DATA]", TRACE_STYLE),
    rows.trace_row("TRACe[:DATA]", TRACE_STYLE, _TRACE_NAME),
    Command("TRACe[:DATA]:PREamble", query=_preamble, query_parameters=(_TRACE_NAME,)),
)

_CHANNEL_POWER_ROWS = (
    Command("CONFigure", query=lambda call: "CHP" if call.instrument.channel.is_selected else "SAN"),
    Command("CONFigure:CHPower", _configure_channel_power),
    rows.channel_switch_row(f"{_SENSE}:CHPower:STATe", "is_selected"),
    _CHANNEL_WIDTH_ROW,
    rows.numeric(f"{_SENSE}:CHPower:FREQuency:SPAN", "span_hz", HERTZ),
    *rows.channel_power_rows("FETCh:CHPower<2>", _channel_results),
    *rows.channel_power_rows("READ:CHPower<2>", _channel_results, rows.start_sweep),
    *rows.channel_power_rows("MEASure:CHPower<2>", _channel_results, _measure_channel_power),
)

_MISCELLANEOUS_ROWS = (
    rows.constant("*IDN", IDENTITY),
    rows.constant("*OPT", '"0031,0726"'),
    sweeps.application_row("INSTrument[:SELect]", '"SPA"', frozenset({"SPA"})),
    sweeps.application_row(f"{_SENSE}:MODE", "SPEC", frozenset({"SPEC", "SPECTRUM"})),
    rows.constant(f"{_SENSE}:MODE:CATalog", "SPEC"),
    rows.constant("FETCh:GPS", _NO_FIX),
    rows.constant("FETCh:GPS:FULL", _NO_FIX),
    rows.constant("FETCh:GPS:ALL", _NO_FIX),
    rows.constant("FETCh:GPS:LAST", _NO_FIX),
    *sweeps.LOCAL_ROWS,
)

ANRITSU = Dialect(
    name="anritsu",
    identity=IDENTITY,
    model=MS2090A,
    own_noise_dbm_hz=-150.0,
    deviations=(
        "There is no GPS fix: every `FETCh:GPS` answers `NO FIX`.",
        "Of the parameters of the preamble those stand that describe the sweep.",
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
