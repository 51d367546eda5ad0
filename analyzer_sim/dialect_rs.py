"""Rohde & Schwarz FSV and FSW: the rows that measuring with traces needs. Channel power is not among them.

Deviations from the real instruments, on purpose: the reference level is dBm whatever the unit of the trace; one trace
exists; the count of sweeps combines them by power unless averaging is on; AUTO sweep type sweeps.
"""

from analyzer_sim.command_row import Call, Command
from analyzer_sim.command_settings import boolean, choice, constant, ignored, inert, numeric
from analyzer_sim.commands_common import COMMON_COMMANDS, SYSTEM_COMMANDS
from analyzer_sim.dialect import Dialect
from analyzer_sim.epochs import rfc3339
from analyzer_sim.instrument_settings import QUANTITIES, Settings, store
from analyzer_sim.levels import UNITS, ascii_list, real32_block
from analyzer_sim.models import FSW_26
from analyzer_sim.scpi_errors import ScpiError
from analyzer_sim.scpi_parameters import DBM, DECIBELS, HERTZ, PURE, SECONDS, Boolean, Choice, Numeric, Quoted
from analyzer_sim.spectrum import SweepGrid

IDENTITY = "Rohde&Schwarz,FSW-26,1312.8000K26/100001,5.30"
_DETECTORS = ("RMS", "POSitive", "NEGative", "SAMPle", "APEak", "AVERage")
_TRACES = tuple(f"TRACE{number}" for number in range(1, 7))
_APPLICATIONS = frozenset({"SAN", "SANALYZER", "SPECTRUM"})

_SENSE = "[SENSe<6>]"
_BANDWIDTH = f"{_SENSE}:BANDwidth|BWIDth"
_SWEEP = f"{_SENSE}:SWEep[:WINDow<16>]"
_DETECTOR = f"{_SENSE}[:WINDow<16>]:DETector<6>"
_DISPLAY_TRACE = "DISPlay[:WINDow<16>][:SUBWindow<16>]:TRACe<6>"
_TRACE = "TRACe<16>[:DATA]"


def _freeze_rbw(settings: Settings) -> None:
    settings.rbw_chosen_hz = settings.rbw_hz


def _freeze_vbw(settings: Settings) -> None:
    settings.vbw_chosen_hz = settings.vbw_hz


def _freeze_time(settings: Settings) -> None:
    settings.time_chosen_s = settings.time_s


def _freeze_attenuation(settings: Settings) -> None:
    settings.attenuation_chosen_db = settings.attenuation_db


def _put_full_span(call: Call) -> None:
    store(call.instrument.settings, "span_hz", call.instrument.model.max_frequency_hz)
    call.instrument.invalidate()


def _put_detector(call: Call, word: str) -> None:
    call.instrument.settings.detector = word
    call.instrument.settings.is_detector_auto = False
    call.instrument.invalidate()


def _put_detector_auto(call: Call, is_auto: bool) -> None:  # noqa: FBT001 - the one value of the command
    settings = call.instrument.settings
    settings.is_detector_auto = is_auto
    if is_auto:
        settings.detector = settings.model.detector
    call.instrument.invalidate()


def _put_trace_mode(call: Call, word: str) -> None:
    call.instrument.settings.is_averaging = word == "AVER"
    call.instrument.invalidate()


def _trace_mode(call: Call) -> str:
    return "AVER" if call.instrument.settings.is_averaging else "WRIT"


def _put_continuous(call: Call, is_on: bool) -> None:  # noqa: FBT001 - the one value of the command
    if is_on:
        call.instrument.abort()
    call.instrument.settings.is_continuous = is_on


def _put_format(call: Call, word: str, length: float | str = "") -> None:
    legal = {"ASC": {"", 0.0}, "REAL": {"", 32.0}}[word]
    if length not in legal:
        raise ScpiError(-224, f"{word},{length}")
    call.instrument.settings.data_format = word


def _format(call: Call) -> str:
    return {"ASC": "ASC,0", "REAL": "REAL,32"}[call.instrument.settings.data_format]


def _check_trace(name: str) -> None:
    if name != _TRACES[0]:
        raise ScpiError(-230, f"{name} is blank")


def _trace_levels(call: Call, name: str) -> str | bytes:
    _check_trace(name)
    settings = call.instrument.settings
    values = UNITS[settings.unit](call.instrument.trace().level_dbm)
    return ascii_list(values) if settings.data_format == "ASC" else real32_block(values, is_big_endian=False)


def _trace_frequencies(call: Call, name: str) -> str | bytes:
    _check_trace(name)
    settings = call.instrument.settings
    grid = SweepGrid(settings.start_hz, settings.stop_hz, settings.points, settings.rbw_hz)
    values = grid.frequency_hz + settings.offset_hz
    return ascii_list(values) if settings.data_format == "ASC" else real32_block(values, is_big_endian=False)


def _date(call: Call) -> str:
    year, month, day = rfc3339(call.instrument.epoch_us())[:10].split("-")
    return f"{year},{int(month)},{int(day)}"


def _time(call: Call) -> str:
    hour, minute, second = rfc3339(call.instrument.epoch_us())[11:19].split(":")
    return f"{int(hour)},{int(minute)},{int(second)}"


def _select_application(call: Call, name: str) -> None:  # noqa: ARG001 - there is one application to select
    if name.upper() not in _APPLICATIONS:
        raise ScpiError(-224, name)


def _initiate(call: Call) -> None:
    call.instrument.initiate()


_FREQUENCY_ROWS = (
    numeric(f"{_SENSE}:FREQuency:CENTer", "center_hz", HERTZ),
    numeric(f"{_SENSE}:FREQuency:SPAN", "span_hz", HERTZ),
    numeric(f"{_SENSE}:FREQuency:STARt", "start_hz", HERTZ),
    numeric(f"{_SENSE}:FREQuency:STOP", "stop_hz", HERTZ),
    numeric(f"{_SENSE}:FREQuency:OFFSet", "offset_hz", HERTZ),
    Command(f"{_SENSE}:FREQuency:SPAN:FULL", _put_full_span),
)

_BANDWIDTH_ROWS = (
    numeric(f"{_BANDWIDTH}[:RESolution]", "rbw_hz", HERTZ),
    boolean(f"{_BANDWIDTH}[:RESolution]:AUTO", "is_rbw_auto", _freeze_rbw),
    inert(f"{_BANDWIDTH}[:RESolution]:TYPE", "NORM", ("NORMal",)),
    numeric(f"{_BANDWIDTH}:VIDeo", "vbw_hz", HERTZ),
    boolean(f"{_BANDWIDTH}:VIDeo:AUTO", "is_vbw_auto", _freeze_vbw),
)

_SWEEP_ROWS = (
    numeric(f"{_SWEEP}:POINts", "points"),
    numeric(f"{_SWEEP}:TIME", "time_s", SECONDS),
    boolean(f"{_SWEEP}:TIME:AUTO", "is_time_auto", _freeze_time),
    Command(f"{_SWEEP}:DURation", query=lambda call: f"{QUANTITIES['time_s'].load(call.instrument.settings):.12g}"),
    numeric(f"{_SWEEP}:COUNt", "count"),
    choice(f"{_SWEEP}:TYPE", "sweep_type", ("SWEep", "AUTO", "FFT")),
    inert(f"{_SWEEP}:OPTimize", "AUTO", ("AUTO", "DYNamic", "SPEed")),
    Command(
        f"{_DETECTOR}[:FUNCtion]", _put_detector, lambda call: call.instrument.settings.detector, (Choice(_DETECTORS),)
    ),
    Command(
        f"{_DETECTOR}[:FUNCtion]:AUTO",
        _put_detector_auto,
        lambda call: str(int(call.instrument.settings.is_detector_auto)),
        (Boolean(),),
    ),
    boolean(f"{_SENSE}:AVERage<6>[:STATe<6>]", "is_averaging"),
    numeric(f"{_SENSE}:AVERage<6>:COUNt", "average_count"),
    choice(f"{_SENSE}:AVERage<6>:TYPE", "average_type", ("VIDeo", "LINear", "POWer")),
    Command(f"{_DISPLAY_TRACE}:MODE", _put_trace_mode, _trace_mode, (Choice(("WRITe", "AVERage")),)),
    Command("INITiate<16>[:IMMediate]", _initiate),
    Command("INITiate<16>:CONMeas", _initiate),
    Command(
        "INITiate<16>:CONTinuous",
        _put_continuous,
        lambda call: str(int(call.instrument.settings.is_continuous)),
        (Boolean(),),
    ),
)

_LEVEL_ROWS = (
    numeric(f"{_DISPLAY_TRACE}:Y[:SCALe]:RLEVel", "reference_dbm", DBM),
    numeric("INPut<2>:ATTenuation", "attenuation_db", DECIBELS),
    boolean("INPut<2>:ATTenuation:AUTO", "is_attenuation_auto", _freeze_attenuation),
    boolean("INPut<2>:GAIN:STATe", "is_preamplifier_on"),
    inert("INPut<2>:COUPling", "AC", ("AC", "DC")),
    constant("INPut<2>:IMPedance", "50"),
    choice("UNIT<16>:POWer", "unit", tuple(UNITS), is_display=True),
    choice("CALCulate<16>:UNIT:POWer", "unit", tuple(UNITS), is_display=True),
)

_TRACE_ROWS = (
    Command("FORMat[:DATA]", _put_format, _format, (Choice(("ASCii", "REAL")), Numeric(PURE)), optional=1),
    Command(_TRACE, query=_trace_levels, query_parameters=(Choice(_TRACES),), query_required=1, query_waits=True),
    Command(f"{_TRACE}:X", query=_trace_frequencies, query_parameters=(Choice(_TRACES),), query_required=1),
)

_MISCELLANEOUS_ROWS = (
    constant("*IDN", IDENTITY),
    constant("*OPT", "0"),
    Command("INSTrument[:SELect]", _select_application, lambda _call: "SAN", (Quoted(),)),
    constant("INSTrument:LIST", "'SANALYZER','Spectrum'"),
    constant(f"{_SENSE}:CORRection[:STATe]", "0"),
    inert("TRIGger<16>[:SEQuence]:SOURce", "IMM", ("IMMediate",)),
    constant("TRIGger<16>[:SEQuence]:LEVel", "0"),
    inert("SYSTem:DISPlay:UPDate", "0"),
    ignored("SYSTem:LOCal"),
    ignored("SYSTem:REMote"),
    Command("SYSTem:DATE", query=_date),
    Command("SYSTem:TIME", query=_time),
    Command("SIMulation:EPOCh", query=lambda call: rfc3339(call.instrument.epoch_us())),
)

RS = Dialect(
    name="rs",
    identity=IDENTITY,
    model=FSW_26,
    commands=(
        *COMMON_COMMANDS,
        *SYSTEM_COMMANDS,
        *_FREQUENCY_ROWS,
        *_BANDWIDTH_ROWS,
        *_SWEEP_ROWS,
        *_LEVEL_ROWS,
        *_TRACE_ROWS,
        *_MISCELLANEOUS_ROWS,
    ),
    interface_messages=frozenset({b"&GTL", b"&GTR", b"&DCL", b"&POL", b"&LLO", b"&NREN"}),
)
