"""Rows of the settings that every analyzer has; a dialect says under which headers."""

from analyzer_sim.dialects.rows.command_row import Command
from analyzer_sim.dialects.rows.settings_rows import boolean, ignored, numeric
from analyzer_sim.dialects.rows.span_rows import full_span_row
from analyzer_sim.dialects.rows.sweep_rows import (
    CLOCK_ROWS,
    freeze_attenuation,
    freeze_rbw,
    freeze_time,
    freeze_vbw,
)
from analyzer_sim.scpi.parameters import DECIBELS, HERTZ, SECONDS, Level


def frequency_rows(head: str, step: str) -> tuple[Command, ...]:
    """Return the rows of centre and its step, span, ends and offset."""
    settings = {"CENTer": "center_hz", step: "step_hz", "SPAN": "span_hz", "STARt": "start_hz", "STOP": "stop_hz"}
    settings["OFFSet"] = "offset_hz"
    rows = (numeric(f"{head}:{word}", name, HERTZ) for word, name in settings.items())
    return (*rows, full_span_row(f"{head}:SPAN:FULL"))


def bandwidth_rows(head: str) -> tuple[Command, ...]:
    """Return the rows of the filters and their couplings."""
    return (
        numeric(f"{head}[:RESolution]", "rbw_hz", HERTZ),
        boolean(f"{head}[:RESolution]:AUTO", "is_rbw_auto", freeze_rbw),
        numeric(f"{head}:VIDeo", "vbw_hz", HERTZ),
        numeric(f"{head}:VIDeo:RATio", "vbw_per_rbw"),
        boolean(f"{head}:VIDeo:AUTO", "is_vbw_auto", freeze_vbw),
    )


def sweep_time_rows(head: str) -> tuple[Command, ...]:
    """Return the rows of the sweep time and its coupling."""
    return (
        numeric(f"{head}:TIME", "time_s", SECONDS),
        boolean(f"{head}:TIME:AUTO", "is_time_auto", freeze_time),
    )


def level_rows(scale: str, attenuation: str, preamplifier: str) -> tuple[Command, ...]:
    """Return the rows of the reference level, its offset, attenuator and preamplifier."""
    return (
        numeric(f"{scale}:RLEVel", "reference_dbm", parameter=Level()),
        numeric(f"{scale}:RLEVel:OFFSet", "level_offset_db", DECIBELS),
        numeric(attenuation, "attenuation_db", DECIBELS),
        boolean(f"{attenuation}:AUTO", "is_attenuation_auto", freeze_attenuation),
        boolean(preamplifier, "is_preamplifier_on"),
    )


#: hand-over between front panel and line, and the clock
LOCAL_ROWS = (ignored("SYSTem:LOCal"), ignored("SYSTem:REMote"), *CLOCK_ROWS)
