"""Reference of settings: every setting by the name of its environment variable, its default, meaning and origin.

Law of this file: a setting that is not in the tables cannot be rendered, so none stays undocumented.
"""

import dataclasses
from collections.abc import Iterator
from typing import Any, NamedTuple

from pydantic import SecretStr

from service.composition.settings import Settings

PUBLISHED = "publication"
TUNED = "simulated truth"
CHOSEN = "operation"

#: what each word of the column "origin" means
ORIGINS: dict[str, str] = {
    PUBLISHED: "stated in the publication of the method (Sevast'yanov 2013)",
    TUNED: "the publication gives no number; tuned on the simulator's truth",
    CHOSEN: "a matter of running the service; no figure of the estimate depends on it",
}

#: settings that are plain fields: origin only, the meaning stands with the field
_PLAIN_ORIGINS: dict[str, str] = {
    "database_url": CHOSEN,
    "database_timeout_s": CHOSEN,
    "bootstrap_key": CHOSEN,
    "clock": CHOSEN,
    "host": CHOSEN,
    "port": CHOSEN,
    "log_level": CHOSEN,
    "log_format": CHOSEN,
    "access_log": CHOSEN,
    "metrics_need_key": CHOSEN,
    "ready_lag": CHOSEN,
    "min_free_disk_bytes": CHOSEN,
    "max_streams": CHOSEN,
    "max_sources_per_key": CHOSEN,
    "max_connections": CHOSEN,
    "max_connections_per_address": CHOSEN,
    "tls_certificate": CHOSEN,
    "tls_key": CHOSEN,
    "trusted_proxies": CHOSEN,
    "request_timeout_s": CHOSEN,
    "future_tolerance_s": CHOSEN,
    "future_tolerance_data_s": CHOSEN,
    "late_after_s": CHOSEN,
    "max_body_bytes": CHOSEN,
    "max_rows_per_batch": CHOSEN,
    "evidence_traces": CHOSEN,
    "evidence_bytes": CHOSEN,
    "alarm_notices_from": CHOSEN,
    "alarm_webhook_url": CHOSEN,
    "alarm_webhook_secret": CHOSEN,
    "alarm_mail_host": CHOSEN,
    "alarm_mail_port": CHOSEN,
    "alarm_mail_security": CHOSEN,
    "alarm_mail_user": CHOSEN,
    "alarm_mail_password": CHOSEN,
    "alarm_mail_from": CHOSEN,
    "alarm_mail_to": CHOSEN,
    "kernels": CHOSEN,
}

#: settings inside a stage's configuration: meaning with unit, origin of the default
_STAGE_MEANINGS: dict[str, tuple[str, str]] = {
    "workers.processes": ("worker processes that compute analyses and calibrations", CHOSEN),
    "workers.max_waiting": ("analyses that wait while all workers compute; one more is 429", CHOSEN),
    "workers.max_calibrations": ("calibrations that wait or run; one more is 429", CHOSEN),
    "workers.analysis_timeout_s": ("an analysis is ended after this, s", CHOSEN),
    "workers.job_timeout_s": ("a calibration, or a flight in the orbital frame, is ended after this, s", CHOSEN),
    "alarms.attitude_warning_deg": ("an angle beyond this is a warning, deg", PUBLISHED),
    "alarms.attitude_critical_deg": ("an angle beyond this is critical, deg", PUBLISHED),
    "alarms.stale_periods": ("no row for so many row periods is a warning", CHOSEN),
    "alarms.disk_warning_mb": ("less room than this beside the archive's file is a warning, MB", CHOSEN),
    "alarms.disk_critical_mb": ("less room than this is critical, MB", CHOSEN),
    "alarms.check_period_s": ("links, sources and ages are looked at this often, s", CHOSEN),
    "sealing.quiet_s": ("a day is packed this long after its end and after its last row came in, s", CHOSEN),
    "sealing.period_s": ("between two looks for days to pack and rows to drop, s", CHOSEN),
    "sealing.pause_s": ("between two transactions of that work, so that rows come in between them, s", CHOSEN),
    "retention.measurements_days": ("measurements older than this are dropped and refused; 0 = kept for ever", CHOSEN),
    "retention.attitude_days": ("attitude older than this is dropped; 0 = kept for ever", CHOSEN),
    "retention.torques_days": ("torque commands older than this are dropped; 0 = kept for ever", CHOSEN),
    "retention.traces_days": ("evidence traces older than this are dropped; 0 = kept while the ring has place", CHOSEN),
    "retention.alarms_days": (
        "closed alarms raised longer ago are dropped; 0 = kept for ever",
        CHOSEN,
    ),
    "retention.notes_days": ("notes about instants longer ago are dropped; 0 = kept for ever", CHOSEN),
    "retention.measurements_bytes": ("measurements of one spacecraft take this much at most; 0 = no limit", CHOSEN),
    "retention.attitude_bytes": ("attitude of one spacecraft takes this much at most; 0 = no limit", CHOSEN),
    "retention.torques_bytes": ("torque commands of one spacecraft take this much at most; 0 = no limit", CHOSEN),
    "rate_limit.ingest_per_s": (
        "batches, traces and reports of stations: requests a second of one key; 0 = no limit",
        CHOSEN,
    ),
    "rate_limit.ingest_burst": ("the same: requests at once", CHOSEN),
    "rate_limit.read_per_s": ("what is read: requests a second of one key; 0 = no limit", CHOSEN),
    "rate_limit.read_burst": ("the same: requests at once", CHOSEN),
    "rate_limit.export_per_s": ("exports: requests a second of one key; 0 = no limit", CHOSEN),
    "rate_limit.export_burst": ("the same: requests at once", CHOSEN),
    "rate_limit.control_per_s": ("every other change: requests a second of one key; 0 = no limit", CHOSEN),
    "rate_limit.control_burst": ("the same: requests at once", CHOSEN),
    "rate_limit.anonymous_per_s": ("requests without a valid key, by address: requests a second; 0 = no limit", CHOSEN),
    "rate_limit.anonymous_burst": ("the same: requests at once", CHOSEN),
    "calibration.harmonic.gate_sigma": ("a sample is used while its residual is within this many sigma", PUBLISHED),
    "calibration.harmonic.max_iterations": ("passes of that rejection before the fit gives up", CHOSEN),
    "calibration.criteria.max_residual_rms_db": ("stable: rms after the harmonic at most this, dB", TUNED),
    "calibration.criteria.max_nonlinearity_deg": ("linear: departure from a straight line at most this, deg", TUNED),
    "calibration.criteria.linear_range_deg": ("linear: angles within which the line is judged, deg", PUBLISHED),
    "calibration.criteria.dominance_ratio": ("dominant: greatest coefficient this many times the others", TUNED),
    "calibration.criteria.yaw_scale": ("yaw coefficients are multiplied by this before the comparison", TUNED),
    "calibration.criteria.min_selected": ("carriers selected at least; mixed ones fill up", TUNED),
    "calibration.reference_reach_s": ("a row of the turns needs a sensor reading this close, s", TUNED),
    "calibration.short_quiet_periods": ("quiet windows shorter than this many nodal periods are warned of", TUNED),
    "calibration.min_turn_rows": ("fewest rows with powers and angles in the turns", TUNED),
    "calibration.min_quiet_rows": ("geometry: fewest rows with angles in the quiet window", TUNED),
    "calibration.short_quiet_days": ("geometry: quiet windows shorter than this are warned of, days", TUNED),
    "calibration.min_tracked_share": ("geometry: share of the rows that the track must reach, else warned", TUNED),
    "calibration.max_daily_excess": (
        "geometry: a wave of half a day that the dish law leaves, over its neighbours, else warned",
        TUNED,
    ),
    "calibration.max_slope_shrink": ("geometry: sensor noise may shrink slopes by this share, else warned", TUNED),
    "calibration.flat_share": (
        "geometry: a carrier that turns move by less than this share of its noise is flat",
        TUNED,
    ),
    "calibration.drift_db_per_day": ("geometry: a level that drifts faster is warned of, dB/day", TUNED),
    "calibration.drift_sigmas": ("geometry: and by more than this many of its sigmas", TUNED),
    "calibration.place_chi_square": ("geometry: a station's place is doubted above this chi-square", TUNED),
    "calibration.reference_walk_db_sqrt_h": ("geometry: least walk of a level, dB per square root of hour", TUNED),
    "calibration.level_knot_s": ("knots of a carrier's level over the turns are this far apart at least, s", TUNED),
    "calibration.min_turn_deg": ("an axis counts as turned where its angle passed this, deg", TUNED),
    "calibration.min_yaw_proof_deg": ("turns of yaw below this do not prove its sign, deg", TUNED),
    "calibration.max_scale_error": ("scale by which one axis of a sensor may differ, else warned", TUNED),
    "alignment.manual_window_s": ("window of powers before a manual alignment, s", TUNED),
    "alignment.min_rows": ("fewest rows of a carrier for a reference power", TUNED),
    "alignment.min_probability": ("powers contradict the stated angles below this probability", TUNED),
    "alignment.level_walk_db_sqrt_h": ("wander of a level since calibration, dB per square root of hour", TUNED),
    "alignment.changed_level_sigma": ("a level changed by more sigma is left out of that test", TUNED),
    "estimation.averaging_window_s": ("trailing mean of the deviations, s", TUNED),
    "estimation.min_rows": ("fewest rows of a carrier in that mean", TUNED),
    "estimation.uplink_gate_db": ("uplink rain: a carrier this far below the others is left out, dB", TUNED),
    "estimation.gate_sigma": ("a carrier is used while its residual is within this many sigma", PUBLISHED),
    "estimation.min_carriers": ("fewest carriers of a fix", TUNED),
    "estimation.rate_window_s": ("rates are the slope of the fixes over this time, s", TUNED),
    "estimation.max_gap_s": ("a row later than this after its predecessor starts the means again, s", TUNED),
    "fade.depth_db": ("downlink rain: carriers lie below minus this, dB", TUNED),
    "fade.share": ("share of the carriers that must", TUNED),
    "fade.spread_ratio": ("their spread (1.48 MAD) stays below this share of the median", TUNED),
    "fade.entry_s": ("control stops after the rule has held this long, s", TUNED),
    "fade.exit_s": ("control returns after the median has been above minus depth this long, s", TUNED),
    "fade.max_gap_s": ("a longer pause between rows starts the count of wet time again, s", TUNED),
    "fade.averaging_window_s": ("mean of the deviations that the rule looks at, s", TUNED),
    "interlock.validity_limit_deg": (
        "roll or pitch beyond this inhibits control, yaw beyond it its own, deg",
        PUBLISHED,
    ),
    "interlock.yaw_sigma_limit_deg": ("greatest sigma with which yaw is controlled, deg", TUNED),
    "interlock.roll_sigma_limit_deg": ("greatest sigma of roll with which control is allowed, deg", TUNED),
    "interlock.pitch_sigma_limit_deg": ("greatest sigma of pitch with which control is allowed, deg", TUNED),
    "interlock.min_redundancy": ("fewest carriers beyond the three unknowns", TUNED),
    "torque.min_pulse_s": ("shortest pulse the drive executes, s", TUNED),
    "torque.time_step_s": ("pulses are timed to this, s", TUNED),
    "torque.default_period_s": ("command period until row periods are known, s", CHOSEN),
    "torque.period_rows": ("rows from whose median the command period is taken", CHOSEN),
    "torque.slew_share": ("part of a command's period within which it slews", CHOSEN),
    "torque.balance_s": ("a known torque is balanced this often after the slew, s", CHOSEN),
    "torque.envelope_share": ("share of the envelope that the law uses by itself", CHOSEN),
    "torque.least_wheel_momentum_n_m_s": ("momentum from which null motion keeps a wheel away, N m s", CHOSEN),
    "torque.telemetry_age_s": ("momentum that was told longer ago is not known any more, s", CHOSEN),
    "torque.rate_stale_periods": ("body rates older than so many row periods are not used ...", CHOSEN),
    "torque.rate_stale_margin_s": ("... and this much more, s", CHOSEN),
    "torque.panel_peak_limit_deg": ("what flexible modes may add to the angle of the hub, deg", CHOSEN),
    "release.angle_change_deg": ("a command may change an angle by this much, deg", CHOSEN),
    "release.rate_change_deg_s": ("and a rate by this much, deg/s", CHOSEN),
    "release.impulse_n_m_s": ("sum of the sizes of a command's pulses about an axis, N m s", CHOSEN),
    "release.impulse_an_hour_n_m_s": ("the same over what was sent within an hour, N m s", CHOSEN),
    "release.stale_periods": ("an estimate is too old after this many row periods", CHOSEN),
    "release.stale_margin_s": ("and so many seconds", CHOSEN),
    "release.roll_sigma_limit_deg": ("a greater sigma of roll inhibits, deg", TUNED),
    "release.pitch_sigma_limit_deg": ("a greater sigma of pitch inhibits, deg", TUNED),
    "release.yaw_sigma_limit_deg": ("a greater sigma of yaw withholds the yaw torque, deg", TUNED),
    "release.min_redundancy": ("fewer carriers beyond the unknowns inhibit", CHOSEN),
    "release.ephemeris_ahead_s": ("the ephemeris must reach this far ahead, s", CHOSEN),
    "release.innovation_s": ("innovations outside their band for this long inhibit, s", TUNED),
    "release.good_s": ("an inhibition clears after this long without a reason, s", CHOSEN),
    "release.momentum_share_limit": ("a wheel with more than this share of its greatest momentum trips", CHOSEN),
    "release.clock_jump_s": ("the clock may differ from the steady one by this much, s", CHOSEN),
    "release.missed_log_ratio": ("log-likelihood ratio with which a command's response is missed", TUNED),
    "release.recovery_deg": ("roll or pitch beyond it: single commands by an approver, deg", PUBLISHED),
    "release.hand_over_deg": ("roll or pitch beyond it: over to the sensor mode, deg", TUNED),
    "release.entry_modes": ("on-board modes from which control is entered, by commas; `any`: not looked at", CHOSEN),
    "release.longest_authorisation_s": ("a standing authorisation lasts this long at most, s", CHOSEN),
    "release.request_s": ("the second person must follow the first within this, s", CHOSEN),
    "release.prepared_s": ("a prepared command waits this long for its confirmation, s", CHOSEN),
    "release.uplink_lead_s": ("no schedule begins sooner after its release, s", CHOSEN),
    "release.confirm_s": ("time for a confirmation where nobody says when the schedule begins, s", CHOSEN),
    "release.sign_confirm_s": ("the same for each slew of a sign check, s", CHOSEN),
    "release.sign_check_s": ("a sign check of roll or pitch ends undecided after this, s", TUNED),
    "release.yaw_sign_check_s": ("and one of yaw after this, s", TUNED),
    "release.yaw_sign_least_s": ("a sign check of yaw takes this long at least, s", TUNED),
    "release.wheel_sigma_n_m_s": ("error of a change of a wheel's momentum in telemetry, N m s", CHOSEN),
    "release.latest_stop_s": ("a schedule must be over this long after its release, s", CHOSEN),
    "release.max_unreported": ("released commands without a report at a time", CHOSEN),
    "release.report_s": ("a report may come this long after the end of the schedule, s", CHOSEN),
    "release.tick_s": ("time passes for the interlock at least this often, s", CHOSEN),
    "robust.yaw_drift_deg_h": ("drift of the inertial model about yaw, one sigma, deg/h", TUNED),
    "robust.roll_drift_deg_h": ("the same about roll", TUNED),
    "robust.pitch_drift_deg_h": ("the same about pitch", TUNED),
    "robust.drift_time_h": ("correlation time of the drifts, h", TUNED),
    "robust.correction_scale_error": ("relative error of the effect of an announced correction", TUNED),
    "robust.torque_scale_error": ("relative error of the effect of a torque", TUNED),
    "robust.chain_walk_db_sqrt_h": ("random walk of the receiving chain, dB per square root of hour", TUNED),
    "robust.common_reference_sigma_db": ("what all references may have wrong together at an alignment, dB", TUNED),
    "robust.min_white_db": ("white noise of a carrier is never believed to be below this, dB", TUNED),
    "robust.yaw_validity_limit_deg": ("yaw beyond it is left alone, deg", CHOSEN),
    "robust.yaw_sigma_limit_deg": ("greatest sigma with which the robust method lets yaw be controlled, deg", TUNED),
    "robust.pushed_yaw_sigma_limit_deg": ("the same of a spacecraft that a residual torque turns, deg", TUNED),
    "robust.unknown_torque_n_m": (
        "prior of a residual torque that the catalogue does not state, one sigma, N m",
        CHOSEN,
    ),
    "robust.unknown_torque_yaw_sigma_limit_deg": ("greatest sigma of controlled yaw under such a torque, deg", TUNED),
    "robust.innovation_limit": ("mean normalised innovation squared above which control is withheld", TUNED),
    "robust.relearned_share": ("share of references learned again above which an alignment is advised", TUNED),
    "robust.disagreement_deg": ("methods this far apart in roll or pitch disagree, deg", CHOSEN),
    "robust.disagreement_s": ("when they have been apart for this long, s", CHOSEN),
    "operations.station_keeping_deg": ("sigma of each angle after a burn that states none, deg", TUNED),
    "operations.momentum_unloading_deg": ("the same after an unloading of momentum, deg", TUNED),
    "operations.eclipse_gain_db_sqrt_h": ("walk of a transponder's gain in eclipse, dB per square root of hour", TUNED),
    "operations.eclipse_level_db_sqrt_h": ("walk of single levels in eclipse, dB per square root of hour", TUNED),
    "operations.gain_step_db": ("a gain or the receiving chain moves by this when worked on, dB", TUNED),
    "operations.carrier_step_db": ("a carrier that was worked on comes back within this, dB", TUNED),
}


class SettingEntry(NamedTuple):
    """One setting as it is documented."""

    #: environment variable
    name: str
    default: str
    meaning: str
    origin: str
    #: value in force, secrets hidden
    value: str


def setting_entries(settings: Settings) -> Iterator[SettingEntry]:
    """Yield every setting in the order of its declaration, with the value that some settings give it."""
    for name, field in Settings.model_fields.items():
        value = getattr(settings, name)
        if dataclasses.is_dataclass(value):
            yield from _stage_entries(name, field.default, value)
        else:
            meaning = field.description or ""
            yield SettingEntry(_variable(name), _shown(field.default), meaning, _PLAIN_ORIGINS[name], _shown(value))


def settings_markdown() -> str:
    """Return the page of settings: defaults, whatever the environment says."""
    origins = "\n".join(f"* *{word}*: {meaning}" for word, meaning in ORIGINS.items())
    rows = "\n".join(
        f"| `{entry.name}` | {entry.default} | {entry.meaning} | {entry.origin} |"
        for entry in setting_entries(Settings.model_construct())
    )
    return f"{_HEAD}\n{origins}\n\n| variable | default | meaning | origin |\n|---|---|---|---|\n{rows}\n"


def settings_text(settings: Settings) -> str:
    """Return the values in force, one line a setting; what differs from its default is marked."""
    entries = list(setting_entries(settings))
    width = max(len(entry.name) for entry in entries)
    return "\n".join(
        f"{'*' if entry.value != entry.default else ' '} {entry.name:{width}} {entry.value}" for entry in entries
    )


def _stage_entries(path: str, default: Any, value: Any) -> Iterator[SettingEntry]:
    """Yield the settings of a stage's configuration at every depth."""
    for field in dataclasses.fields(value):
        inner = f"{path}.{field.name}"
        inner_default, inner_value = getattr(default, field.name), getattr(value, field.name)
        if dataclasses.is_dataclass(inner_value):
            yield from _stage_entries(inner, inner_default, inner_value)
        else:
            meaning, origin = _STAGE_MEANINGS[inner]
            yield SettingEntry(_variable(inner), _shown(inner_default), meaning, origin, _shown(inner_value))


def _variable(path: str) -> str:
    """Return the environment variable of a setting."""
    return "SOO_" + path.replace(".", "__").upper()


def _shown(value: object) -> str:
    """Return a value as it is printed; a secret only says that it is set."""
    if isinstance(value, SecretStr):
        return "(set)"
    return "none" if value is None else str(value)


_HEAD = """# Settings

Made by `soo settings --markdown`; `tests/docs/test_settings.py` holds page and code together. Settings are read once,
from the environment, or from the folder that `SOO_SECRETS_DIR` names, which has a file for each, called as the variable
(`soo_bootstrap_key`). A double underscore leads into the configuration of a stage:
`SOO_INTERLOCK__VALIDITY_LIMIT_DEG=0.35`. `soo settings` prints the values in force and marks what was changed; the
database, address, port, clock and the files of TLS can be given to `soo serve` as options, which win.

The column *origin* says where a default comes from:
"""
