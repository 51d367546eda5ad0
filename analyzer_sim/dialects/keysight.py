"""Keysight X-series (N9020B and its kin), Spectrum Analyzer mode, Swept SA measurement.

Where this differs from R&S: after ``*RST`` the instrument sweeps once on INITiate, after ``SYSTem:PRESet`` without end;
the detector AVERage takes its kind of mean from ``AVERage:TYPE``; blocks are big-endian until ``FORMat:BORDer SWAP``;
an empty error queue answers ``+0``; ``FETCh:SANalyzer?`` answers pairs of frequency and level.

Channel power sweeps with settings of its own. Its verbs, and those of the spectrum (SCPI-99, volume 2, chapter 3)::

    CONFigure   select it and return its settings to their defaults; CONFigure:..:NDEFault keeps them
    INITiate    select it as it is set and start a sweep
    FETCh?      answer from the sweep there is; -230 when there is none, -221 when another measurement is selected
    READ?       INITiate and FETCh?          MEASure?    CONFigure, INITiate and FETCh?

A result that does not exist is 9.91E37. Of the results numbered behind a measurement the first and, for the trace, the
second are there.
"""

from collections.abc import Mapping

from analyzer_sim.dialects import settings_rows as rows
from analyzer_sim.dialects import sweep_rows as sweeps
from analyzer_sim.dialects.dialect import Call, Command, Dialect, TraceFormat, TraceStyle
from analyzer_sim.instrument.channel_power import OWN_AVERAGES, OWN_SPAN_HZ, own_sweep_settings
from analyzer_sim.instrument.instrument_settings import N9020B, Settings, reset_state
from analyzer_sim.instrument.levels import ascii_list
from analyzer_sim.instrument.quantities import load, shown_limits, store
from analyzer_sim.scpi.errors import ScpiError
from analyzer_sim.scpi.parameters import DECIBELS, HERTZ, PURE, SECONDS, Choice, Numeric, TraceName

IDENTITY = "Keysight Technologies,N9020B,MY57430101,A.30.05"
_OPTIONS = '"526,B25,EA3,P26"'
_DETECTORS = {
    "NORMal": "APE",
    "AVERage": sweeps.BY_TYPE,
    "POSitive": "POS",
    "SAMPle": "SAMP",
    "NEGative": "NEG",
    "QPEak": "QPE",
}
_FILTER_TYPES = {"DB3": 1.0, "DB6": sweeps.DB6_RATIO, "NOISe": sweeps.NOISE_RATIO, "IMPulse": sweeps.IMPULSE_RATIO}
_AVERAGE_TYPES = {"LOG": "VID", "RMS": "POW", "SCALar": "LIN"}
_UNITS = ("DBM", "DBMV", "DBMA", "V", "W", "A", "DBUV", "DBUA", "DBPW")
_FIELD_UNITS = ("DBUVM", "DBUAM", "DBPT", "DBG")
TRACE_STYLE = TraceStyle(
    (
        TraceFormat("ASCii", 8, "ASC,8", "ASC"),
        TraceFormat("REAL", 32, "REAL,32", "REAL,32"),
        TraceFormat("REAL", 64, "REAL,64", "REAL,64"),
        TraceFormat("INTeger", 32, "INT,32", "INT,32"),
    )
)

#: settings of the instrument, not of a measurement: CONFigure and MEASure leave them
_KEPT_BY_CONFIGURE = ("is_continuous", "unit", "data_format", "is_big_endian", "inert")

_SENSE = "[SENSe<1>]"
_BANDWIDTH = f"{_SENSE}:BANDwidth|BWIDth"
_TRACE_Y = "DISPlay:WINDow<1>[:TRACe<6>]:Y[:SCALe]"
_POWER = f"{_SENSE}:POWer[:RF]"
_SPECTRUM = "SANalyzer<6>"
_CHANNEL = f"{_SENSE}:CHPower"


def _put_sweep_type(call: Call, word: str) -> None:
    call.instrument.settings.sweep_type = word
    call.instrument.invalidate()


def _sweep_type(call: Call) -> str:
    return "FFT" if call.instrument.settings.is_fft else "SWE"


def _put_sweep_type_auto(call: Call, is_auto: bool) -> None:  # noqa: FBT001 - the one value of the command
    _put_sweep_type(call, "AUTO" if is_auto else _sweep_type(call))


def _put_average_type_auto(call: Call, is_auto: bool) -> None:  # noqa: FBT001 - the one value of the command
    settings = call.instrument.settings
    if is_auto:
        settings.average_type = settings.model.average_type
        call.instrument.invalidate()


def _keep_spectrum(call: Call) -> None:
    call.instrument.channel.is_selected = False
    call.instrument.invalidate()


def _configure_spectrum(call: Call) -> None:
    """Return the measurement to its defaults; what belongs to the whole instrument stays."""
    settings, fresh = call.instrument.settings, reset_state(call.instrument.model)
    for name in _KEPT_BY_CONFIGURE:
        setattr(fresh, name, getattr(settings, name))
    call.instrument.settings = fresh
    _keep_spectrum(call)


def _measure_spectrum(call: Call) -> None:
    _configure_spectrum(call)
    rows.start_sweep(call)


def _initiate_spectrum(call: Call) -> None:
    call.instrument.channel.is_selected = False
    call.instrument.initiate()


def _restart(call: Call) -> None:
    """Begin again: a single sweep when it does not sweep without end."""
    call.instrument.abort()
    call.instrument.invalidate()
    if not call.instrument.settings.is_continuous:
        call.instrument.initiate()


def _select_channel_power(call: Call) -> None:
    channel = call.instrument.channel
    if not channel.is_selected:
        channel.is_selected = channel.is_own_sweep = True
        call.instrument.abort()
        call.instrument.invalidate()


def _configure_channel_power(call: Call) -> None:
    rows.reset_channel(call)
    _select_channel_power(call)


def _initiate_channel_power(call: Call) -> None:
    _select_channel_power(call)
    call.instrument.initiate()


def _read_channel_power(call: Call) -> None:
    _select_channel_power(call)
    rows.start_sweep(call)


def _measure_channel_power(call: Call) -> None:
    _configure_channel_power(call)
    rows.start_sweep(call)


def _channel_results(call: Call, which: slice) -> str:
    if not call.instrument.channel.is_selected:
        raise ScpiError(-221, "CHP is not selected")
    values = rows.channel_power(call)[which]
    is_trace = len(values) > 1 and call.suffix("CHPower") > 1
    return ascii_list(rows.levels_shown(call)) if is_trace else rows.results_text(values)


def _channel_sweep(call: Call) -> Settings:
    """Return the settings of the sweeps of the channel power, selected or not."""
    return own_sweep_settings(call.instrument.settings, call.instrument.channel)


def _coupled_rows(pattern: str, name: str, units: Mapping[str, float]) -> tuple[Command, Command]:
    """Return the rows of the filter or the time of the channel power and of its coupling."""

    def write(call: Call, value: float | str) -> None:
        settings = _channel_sweep(call)
        limits = shown_limits(settings, name)
        words = {"MIN": limits.low, "MAX": limits.high, "DEF": limits.default}
        if isinstance(value, str) and value not in words:
            raise ScpiError(-141, value)
        number = words[value] if isinstance(value, str) else value
        is_clamped = store(settings, name, number)
        setattr(call.instrument.channel, name, load(settings, name))
        call.instrument.invalidate()
        if is_clamped:
            raise ScpiError(-222, f"{number:g}")

    def write_auto(call: Call, is_auto: bool) -> None:  # noqa: FBT001 - the one value of the command
        setattr(call.instrument.channel, name, None if is_auto else load(_channel_sweep(call), name))
        call.instrument.invalidate()

    return (
        Command(pattern, write, lambda call: rows.number_text(load(_channel_sweep(call), name)), (Numeric(units),)),
        rows.switch(f"{pattern}:AUTO", write_auto, lambda call: getattr(call.instrument.channel, name) is None),
    )


_FREQUENCY_ROWS = (
    *rows.frequency_rows(f"{_SENSE}:FREQuency", "CENTer:STEP[:INCRement]"),
    rows.step_auto_row(f"{_SENSE}:FREQuency:CENTer:STEP:AUTO"),
    rows.span_row(f"{_SENSE}:FREQuency:SPAN:PREVious", lambda settings: settings.previous_span_hz),
    rows.numeric(f"{_SENSE}:FREQuency:SPAN:BANDwidth[:RESolution]:RATio", "span_per_rbw"),
    rows.span_row(f"{_SENSE}:FREQuency:SPAN:ZERO", lambda _settings: 0.0),
)

_BANDWIDTH_ROWS = (
    *rows.bandwidth_rows(_BANDWIDTH),
    sweeps.filter_type_row(f"{_BANDWIDTH}[:RESolution]:TYPE", _FILTER_TYPES),
    rows.inert(f"{_BANDWIDTH}:SHAPe", "GAUS", ("GAUSsian",)),
)

_SWEEP_ROWS = (
    rows.numeric(f"{_SENSE}:SWEep:POINts", "points"),
    *rows.sweep_time_rows(f"{_SENSE}:SWEep"),
    rows.inert(f"{_SENSE}:SWEep:TIME:AUTO:RULes", "NORM", ("NORMal", "ACCuracy", "SRESponse")),
    Command(f"{_SENSE}:SWEep:TYPE", _put_sweep_type, _sweep_type, (Choice(("SWEep", "FFT", "AUTO")),)),
    rows.switch(
        f"{_SENSE}:SWEep:TYPE:AUTO", _put_sweep_type_auto, lambda call: call.instrument.settings.sweep_type == "AUTO"
    ),
    *sweeps.detector_rows(f"{_SENSE}:DETector:TRACe<6>", f"{_SENSE}:DETector:TRACe<6>:AUTO", _DETECTORS),
    *sweeps.detector_rows(f"{_SENSE}:DETector[:FUNCtion]", f"{_SENSE}:DETector:AUTO", _DETECTORS),
    sweeps.average_state_row(f"{_SENSE}:AVERage[:STATe]"),
    rows.numeric(f"{_SENSE}:AVERage:COUNt", "average_count"),
    sweeps.average_type_row(f"{_SENSE}:AVERage:TYPE", _AVERAGE_TYPES, does_detector_follow=True),
    rows.switch(
        f"{_SENSE}:AVERage:TYPE:AUTO",
        _put_average_type_auto,
        lambda call: call.instrument.settings.average_type == N9020B.average_type,
    ),
    sweeps.trace_mode_row("TRACe<6>:TYPE", "WRITe"),
    sweeps.initiate_row("INITiate[:IMMediate]"),
    sweeps.continuous_row("INITiate:CONTinuous"),
    Command("INITiate:RESTart", _restart),
    Command("INITiate:SANalyzer", _initiate_spectrum),
    rows.inert("TRIGger[:SEQuence]:SOURce", "IMM", ("IMMediate",)),
    rows.inert("TRIGger[:SEQuence]:RF:SOURce", "IMM", ("IMMediate",)),
)

_LEVEL_ROWS = (
    *rows.level_rows(_TRACE_Y, f"{_POWER}:ATTenuation", f"{_POWER}:GAIN[:STATe]"),
    rows.inert_number(f"{_TRACE_Y}:PDIVision", 10.0, 0.1, 20.0, DECIBELS),
    rows.inert(f"{_POWER}:GAIN:BAND", "LOW", ("LOW", "FULL")),
    rows.inert(f"{_POWER}:MW:PATH", "STD", ("STD", "LNPath", "MPBypass", "FULL")),
    rows.inert("INPut<1>:COUPling", "AC", ("AC", "DC")),
    rows.constant(f"{_SENSE}:CORRection:IMPedance[:INPut][:MAGNitude]", "50"),
    sweeps.unit_row("UNIT:POWer", _UNITS, _FIELD_UNITS),
)

_TRACE_ROWS = (
    rows.format_row("FORMat[:TRACe][:DATA]", TRACE_STYLE),
    rows.byte_order_row("FORMat:BORDer"),
    rows.trace_row("TRACe[:DATA]", TRACE_STYLE, TraceName(("TRACE",), 6)),
    Command("CALCulate:DATA<6>", query=rows.trace_reader(TRACE_STYLE, rows.pairs_shown, "DATA"), query_waits=True),
    *(
        Command(
            f"{verb}:{_SPECTRUM}",
            query=rows.trace_reader(TRACE_STYLE, rows.pairs_shown, "SANalyzer"),
            query_waits=True,
            query_starts=starts,
        )
        for verb, starts in (("FETCh", None), ("READ", rows.start_sweep), ("MEASure", _measure_spectrum))
    ),
)

_CHANNEL_POWER_ROWS = (
    Command("CONFigure:CHPower", _configure_channel_power),
    Command("CONFigure:CHPower:NDEFault", _select_channel_power),
    Command("INITiate:CHPower", _initiate_channel_power),
    *rows.channel_power_rows("FETCh:CHPower<2>", _channel_results),
    *rows.channel_power_rows("READ:CHPower<2>", _channel_results, _read_channel_power),
    *rows.channel_power_rows("MEASure:CHPower<2>", _channel_results, _measure_channel_power),
    rows.channel_row(f"{_CHANNEL}:BANDwidth|BWIDth:INTegration", "width_hz", N9020B.channel_width_hz),
    rows.channel_row(f"{_CHANNEL}:FREQuency:SPAN", "span_hz", OWN_SPAN_HZ, reshapes=True),
    rows.channel_row(f"{_CHANNEL}:AVERage:COUNt", "averages", OWN_AVERAGES, PURE, reshapes=True, is_whole=True),
    rows.channel_switch_row(f"{_CHANNEL}:AVERage[:STATe]", "is_averaging", reshapes=True),
    *_coupled_rows(f"{_CHANNEL}:BANDwidth|BWIDth[:RESolution]", "rbw_hz", HERTZ),
    *_coupled_rows(f"{_CHANNEL}:SWEep:TIME", "time_s", SECONDS),
)

_MISCELLANEOUS_ROWS = (
    rows.constant("*IDN", IDENTITY),
    rows.constant("*OPT", _OPTIONS),
    rows.constant("*CAL", "0"),
    rows.constant("SYSTem:OPTions", _OPTIONS),
    sweeps.application_row("INSTrument[:SELect]", "SA", frozenset({"SA"})),
    rows.constant("INSTrument:CATalog", '"SA 1"'),
    rows.inert_number("INSTrument:NSELect", 1.0, 1.0, 1.0),
    Command("CONFigure", query=lambda call: "CHP" if call.instrument.channel.is_selected else "SAN"),
    rows.constant("CONFigure:CATalog", '"SAN, CHP"'),
    Command("CONFigure:SANalyzer", _configure_spectrum),
    Command("CONFigure:SANalyzer:NDEFault", _keep_spectrum),
    rows.inert("CALibration:AUTO", "ON", ("ON", "PARTial", "OFF", "ALERt")),
    rows.inert("DISPlay:ENABle", "1"),
    *sweeps.register_rows("STATus:QUEStionable:INTegrity", lambda status: status.questionable_integrity),
    *sweeps.LOCAL_ROWS,
)

KEYSIGHT = Dialect(
    name="keysight",
    identity=IDENTITY,
    model=N9020B,
    own_noise_dbm_hz=-148.0,
    deviations=(
        "Field strength units are refused (-221): there is no antenna factor.",
        "Of the numbered results of a measurement the first and, for its trace, the second are there; the Swept SA "
        "measurement answers pairs for trace 1.",
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
