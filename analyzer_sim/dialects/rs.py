"""Rohde & Schwarz FSV and FSW: what measuring with traces needs, and the channel power of the trace shown."""

from analyzer_sim.dialects import settings_rows as rows
from analyzer_sim.dialects import sweep_rows as sweeps
from analyzer_sim.dialects.dialect import Call, Command, Dialect, TraceFormat, TraceStyle
from analyzer_sim.instrument.instrument_settings import FSW_26
from analyzer_sim.instrument.quantities import QUANTITIES
from analyzer_sim.scpi.errors import ScpiError
from analyzer_sim.scpi.parameters import DECIBELS, Choice, TraceName

IDENTITY = "Rohde&Schwarz,FSW-26,1312.8000K26/100001,5.30"
_DETECTORS = {
    "RMS": "RMS",
    "POSitive": "POS",
    "NEGative": "NEG",
    "SAMPle": "SAMP",
    "APEak": "APE",
    "AVERage": "AVER",
    "QPEak": "QPE",
}
_TRACE_NAME = TraceName(("TRACE",), 6, is_number_legal=False)
_APPLICATIONS = frozenset({"SAN", "SANALYZER", "SPECTRUM"})
_UNITS = ("DBM", "V", "A", "W", "DBPW", "DBUV", "DBMV", "DBUA")
_SYNONYMS = {"AMPere": "A", "VOLT": "V", "WATT": "W"}
#: little-endian, and no FORMat:BORDer to change it
TRACE_STYLE = TraceStyle((TraceFormat("ASCii", 0, "ASC,0", "ASC"), TraceFormat("REAL", 32, "REAL,32", "REAL,32")))

_SENSE = "[SENSe<6>]"
_FREQUENCY = f"{_SENSE}[:WINDow<16>]:FREQuency"
_BANDWIDTH = f"{_SENSE}:BANDwidth|BWIDth"
_SWEEP = f"{_SENSE}:SWEep[:WINDow<16>]"
_DETECTOR = f"{_SENSE}[:WINDow<16>]:DETector<6>"
_DISPLAY_TRACE = "DISPlay[:WINDow<16>][:SUBWindow<16>]:TRACe<6>"
_TRACE = "TRACe<16>[:DATA]"
_POWER = "CALCulate<16>:MARKer<16>:FUNCtion:POWer<8>"
_CHANNEL = f"{_SENSE}:POWer:ACHannel"
_POWER_MEASUREMENTS = (Choice(("CPOWer",)),)


def _select_channel_power(call: Call, _measurement: str) -> None:
    """Select the measurement; a detector that follows it becomes RMS."""
    settings = call.instrument.settings
    call.instrument.channel.is_selected = True
    if settings.is_detector_auto and settings.detector != "RMS":
        settings.detector = "RMS"
        call.instrument.invalidate()


def _deselect(call: Call, is_on: bool) -> None:  # noqa: FBT001 - the one value of the command
    if is_on:
        raise ScpiError(-224, "a measurement is switched on by SELect")
    call.instrument.channel.is_selected = False


def _channel_result(call: Call, _measurement: str = "") -> str:
    return rows.results_text((rows.channel_power(call)[int(call.instrument.channel.is_density)],))


_FREQUENCY_ROWS = (
    *rows.frequency_rows(_FREQUENCY, "CENTer:STEP"),
    rows.step_auto_row(f"{_FREQUENCY}:CENTer:STEP:AUTO"),
    rows.inert(f"{_FREQUENCY}:MODE", "SWE", ("SWEep",)),
)

_BANDWIDTH_ROWS = (
    *rows.bandwidth_rows(_BANDWIDTH),
    rows.inert(f"{_BANDWIDTH}[:RESolution]:TYPE", "NORM", ("NORMal",)),
    rows.numeric(f"{_BANDWIDTH}[:RESolution]:RATio", "rbw_per_span"),
    rows.inert(f"{_BANDWIDTH}:VIDeo:TYPE", "LIN", ("LINear", "LOGarithmic")),
)

_SWEEP_ROWS = (
    rows.numeric(f"{_SWEEP}:POINts", "points"),
    *rows.sweep_time_rows(_SWEEP),
    Command(f"{_SWEEP}:DURation", query=lambda call: f"{QUANTITIES['time_s'].load(call.instrument.settings):.12g}"),
    rows.numeric(f"{_SWEEP}:COUNt", "count"),
    rows.choice(f"{_SWEEP}:TYPE", "sweep_type", ("SWEep", "AUTO", "FFT")),
    Command(f"{_SWEEP}:TYPE:USED", query=lambda call: "FFT" if call.instrument.settings.is_fft else "SWE"),
    rows.inert(f"{_SWEEP}:OPTimize", "AUTO", ("AUTO", "DYNamic", "SPEed")),
    *sweeps.detector_rows(f"{_DETECTOR}[:FUNCtion]", f"{_DETECTOR}[:FUNCtion]:AUTO", _DETECTORS),
    sweeps.average_state_row(f"{_SENSE}:AVERage<6>[:STATe<6>]"),
    rows.numeric(f"{_SENSE}:AVERage<6>:COUNt", "average_count"),
    sweeps.average_type_row(f"{_SENSE}:AVERage<6>:TYPE", {"VIDeo": "VID", "LINear": "LIN", "POWer": "POW"}),
    sweeps.trace_mode_row(f"{_DISPLAY_TRACE}:MODE", "WRITe"),
    sweeps.initiate_row("INITiate<16>[:IMMediate]"),
    sweeps.initiate_row("INITiate<16>:CONMeas"),
    sweeps.continuous_row("INITiate<16>:CONTinuous"),
)

_LEVEL_ROWS = (
    *rows.level_rows(f"{_DISPLAY_TRACE}:Y[:SCALe]", "INPut<2>:ATTenuation", "INPut<2>:GAIN:STATe"),
    rows.inert_number(f"{_DISPLAY_TRACE}:Y[:SCALe]", 100.0, 1.0, 200.0, DECIBELS),
    rows.inert_number(f"{_DISPLAY_TRACE}:Y[:SCALe]:PDIVision", 10.0, 0.1, 20.0, DECIBELS),
    rows.inert(f"{_DISPLAY_TRACE}:Y[:SCALe]:MODE", "ABS", ("ABSolute", "RELative")),
    rows.inert(f"{_DISPLAY_TRACE}:Y:SPACing", "LOG", ("LOGarithmic", "LINear", "LDB", "PERCent")),
    rows.inert("INPut<2>:COUPling", "AC", ("AC", "DC")),
    rows.constant("INPut<2>:IMPedance", "50"),
    sweeps.unit_row("UNIT<16>:POWer", _UNITS, synonyms=_SYNONYMS),
    sweeps.unit_row("CALCulate<16>:UNIT:POWer", _UNITS, synonyms=_SYNONYMS),
)

_TRACE_ROWS = (
    rows.format_row("FORMat[:DATA]", TRACE_STYLE),
    rows.trace_row(_TRACE, TRACE_STYLE, _TRACE_NAME),
    Command(
        f"{_TRACE}:X",
        query=rows.trace_reader(TRACE_STYLE, rows.frequencies_shown),
        query_parameters=(_TRACE_NAME,),
        query_required=1,
    ),
)

_CHANNEL_POWER_ROWS = (
    Command(
        f"{_POWER}:SELect",
        _select_channel_power,
        lambda call: "CPOW" if call.instrument.channel.is_selected else "OFF",
        _POWER_MEASUREMENTS,
    ),
    rows.switch(f"{_POWER}[:STATe]", _deselect, lambda call: call.instrument.channel.is_selected),
    Command(
        f"{_POWER}:RESult",
        query=_channel_result,
        query_parameters=_POWER_MEASUREMENTS,
        query_required=1,
        query_waits=True,
    ),
    rows.channel_switch_row(f"{_POWER}:RESult:PHZ", "is_density"),
    rows.inert(f"{_POWER}:MODE", "WRIT", ("WRITe",)),
    Command("FETCh<16>:CPOWer:RESult", query=_channel_result, query_waits=True),
    rows.channel_row(f"{_CHANNEL}:BWIDth|BANDwidth[:CHANnel<18>]", "width_hz", FSW_26.channel_width_hz),
    rows.inert_number(f"{_CHANNEL}:TXCHannel:COUNt", 1.0, 1.0, 1.0),
)

_MISCELLANEOUS_ROWS = (
    rows.constant("*IDN", IDENTITY),
    rows.constant("*OPT", "0"),
    sweeps.application_row("INSTrument[:SELect]", "SAN", _APPLICATIONS),
    rows.constant("INSTrument:LIST", "'SANALYZER','Spectrum'"),
    rows.constant(f"{_SENSE}:CORRection[:STATe]", "0"),
    rows.inert("TRIGger<16>[:SEQuence]:SOURce", "IMM", ("IMMediate",)),
    rows.constant("TRIGger<16>[:SEQuence]:LEVel", "0"),
    rows.inert("SYSTem:DISPlay:UPDate", "0"),
    rows.inert("DISPlay:FORMat", "SING", ("SINGle", "SPLit")),
    *sweeps.LOCAL_ROWS,
)

RS = Dialect(
    name="rs",
    identity=IDENTITY,
    model=FSW_26,
    deviations=(
        "`SWEep:COUNt` without averaging combines the sweeps by the mean of mW.",
        "One transmission channel; sub-blocks and windows are one.",
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
    interface_messages=frozenset({b"&GTL", b"&GTR", b"&DCL", b"&POL", b"&LLO", b"&NREN"}),
)
