"""Sixty errors that a developer could make and a user would suffer from.

Each one names a function by its qualified name, wherever its file lies below service or db, a text that stands in it
once, and the text of the error. Who moves a function changes nothing here; who edits the text repairs the mutant:
`test_mutants_apply.py` names it.
"""

from typing import NamedTuple


class Mutant(NamedTuple):
    """One error: in the function or method `name`, `old` becomes `new`."""

    name: str
    old: str
    new: str


CORE = (
    # pitch turns the other way
    Mutant("body_from_nadir", "[cp * cy, cp * sy, -sp]", "[cp * cy, cp * sy, sp]"),
    Mutant("attitude_of_quaternion", "-np.arcsin(", "np.arcsin("),
    # a quaternion and its negative give torques of opposite sign
    Mutant("error_angles_rad", "math.copysign(2.0, scalar)", "2.0"),
    Mutant("body_rate_rad_s", "roll_rate - yaw_rate * math.sin(pitch)", "roll_rate + yaw_rate * math.sin(pitch)"),
    # roll and yaw exchange the wrong way round
    Mutant(
        "feedback_torque",
        "wanted[0] += gains.orbital_rate_rad_s * rate[1]",
        "wanted[0] -= gains.orbital_rate_rad_s * rate[1]",
    ),
    # a wheel turns the body its own way
    Mutant("allocate_to_wheels", "-torque_n_m @", "torque_n_m @"),
    Mutant("allocate", "share * wheels_n_m[k] + 0.0", "wheels_n_m[k]"),
    # a saturated request is saved up
    Mutant("shape_pulses", "0.0 if is_saturated else wanted", "wanted"),
    # an effect that is no number passes the envelope
    Mutant("envelope_excesses", "if not value <= limit * (1.0 + _ROUNDING)", "if value > limit * (1.0 + _ROUNDING)"),
    # an instant at a node belongs to the orbit before
    Mutant("latest_node_us", 'side="right"', 'side="left"'),
    Mutant("fit_harmonics", "np.arctan2(-a2, a1)", "np.arctan2(a2, a1)"),
    Mutant("fade_sign_test", "value < -depth_db", "value < depth_db"),
    # minutes of rain before a gap count after it
    Mutant("step_fade_watch", "wet_s, dry_s, elapsed_s = 0.0, 0.0, 0.0", "wet_s = 0.0"),
    # slopes of negative angles change their sign
    Mutant("one_sided_columns", "np.minimum(angle_deg, 0.0)", "-np.minimum(angle_deg, 0.0)"),
    # a new level stays correlated with the attitude
    Mutant("restart_carrier", "covariance[:, place] = 0.0", "covariance[place, :] = 0.0"),
    # drift without process noise: sigma too small
    Mutant("step_motion", "drift_noise(model, hours, drift_scale)", "np.zeros((9, 9))"),
    Mutant(
        "update_state",
        "covariance[i, j] -= 0.5 * (product[i, j] + product[j, i])",
        "covariance[i, j] += 0.5 * (product[i, j] + product[j, i])",
    ),
    Mutant(
        "_write_rotation",
        "matrix[0, first], matrix[0, first + 1] = value.real, -value.imag",
        "matrix[0, first], matrix[0, first + 1] = value.real, value.imag",
    ),
    Mutant("innovate", "- 0.5 * bend * at_deg[axis]", "+ 0.5 * bend * at_deg[axis]"),
    # noise of one bin is taken off a carrier of many
    Mutant("measure_carriers", "total_mw - noise_bin_mw * weights.band_sum", "total_mw - noise_bin_mw"),
)
PIPELINE = (
    # every row counts as late
    Mutant("system_bounds", "now_us - _us(late_after_s)", "now_us + _us(late_after_s)"),
    # flags of another plan are taken
    Mutant("_has_width", "(masks is None or len(masks) == width)", "True"),
    # a second row of one epoch moves the filter again
    Mutant("Chain.rows", "each.epoch_us <= newest_us", "each.epoch_us < newest_us"),
    Mutant(
        "_left_by_harmonic_db",
        'block.power_dbm[number, k] - levels["expected_dbm"][k]',
        'levels["expected_dbm"][k] - block.power_dbm[number, k]',
    ),
    # a turn of yaw leaves roll alone
    Mutant("rates_deg_h", "rates_deg_h[0] -= coupling_per_h", "rates_deg_h[0] += coupling_per_h"),
    # an angle that is far away allows control
    Mutant("_of_fix", "> config.model_range_deg", "< -config.model_range_deg"),
    # yaw and roll are judged, pitch is not
    Mutant(
        "filtered_rows",
        "_, roll_deg, pitch_deg = figures.attitude_deg",
        "roll_deg, pitch_deg, _ = figures.attitude_deg",
    ),
    Mutant("push_readings", ">= _ROWS and is_lasting", ">= _ROWS or is_lasting"),
    # the angle at the alignment counts twice
    Mutant("reference_powers", "- turned_db", "+ turned_db"),
    # an alarm returns within its deadband
    Mutant("_is_gone", "return reported >= bound + limits.deadband", "return reported >= bound"),
    # shelved and suppressed alarms are sent again
    Mutant(
        "AlarmEngine._is_to_repeat",
        "alarm.process is Process.UNACKNOWLEDGED and alarm.cover is Cover.NONE",
        "alarm.process is Process.UNACKNOWLEDGED",
    ),
    # the sign of yaw counts as proven without a turn about yaw
    Mutant("report_signs", "is_yaw_proven = is_turned and verdict", "is_yaw_proven = verdict"),
    # the daily wave of the known torque runs backwards
    Mutant("write_wave", "cos * mean[three] - sin * mean[two]", "cos * mean[three] + sin * mean[two]"),
    Mutant("control_inhibitions", "spacecraft.onboard.fast_loop and", "spacecraft.onboard.fast_loop or"),
    # an axis whose torque is withheld gets one
    Mutant("mean_command", "if is_allowed[axis]:", "if axis >= 0:"),
)
RELEASE = (
    # one person is enough
    Mutant(
        "_confirm_refusal",
        "if event.by == command.prepared_by or not event.is_approver:",
        "if not event.is_approver:",
    ),
    Mutant("_confirm_refusal", "if event.digest != command.digest:", "if not event.digest:"),
    # a command goes while the one before is not reported
    Mutant("release_checks", '_check("reports", not waiting,', '_check("reports", len(waiting) < 2,'),
    # an estimate from the future is believed
    Mutant(
        "row_conditions",
        "not -stale_us <= now_us - row.epoch_us <= stale_us",
        "now_us - row.epoch_us > stale_us",
    ),
    # impulses of the last hour are not counted
    Mutant("sent_within_an_hour", "now_us - sent.at_us < _HOUR_US", "now_us - sent.at_us > _HOUR_US"),
    # the second person of an authorisation may be the first
    Mutant("_is_second", "former.by == asked.by or former.terms", "former.terms"),
    # wheels that run backwards are never full
    Mutant("_momentum_share", "else abs(h)", "else h"),
    # standing authorisation: a command over the one that is under way
    Mutant("_send", "if is_busy or at.now_us", "if at.now_us"),
    # a row from before the trip, computed after it, gets a torque
    Mutant("without_torque_after", "trip.number > command.number", "trip.number < command.number"),
    Mutant("allowed_row", "(yaw and not interlock.is_yaw_withheld, roll", "(yaw, roll"),
)
ARCHIVE = (
    # the newest row, sent again, is stored twice or fails
    Mutant("PreparedBatch.is_beyond", "self.epochs_us[0] > epoch_us", "self.epochs_us[0] >= epoch_us"),
    # other content for a stored row passes as a duplicate
    Mutant("sort_rows", "elif earlier == content:", "elif earlier is not content:"),
    # a row behind the consumed ones counts as in time
    Mutant("_Ingest.store", "batch.is_stale | (prepared.batch.epochs_us < consumed_us)", "batch.is_stale"),
    # compare and swap: two processes release from one state
    Mutant("_swap", "if (found or 0) != version:", "if (found or 0) < version:"),
    # a former leader writes on
    Mutant("FileLeases.under", "if self._is_wanted and not", "if not self._is_wanted and not"),
    # a sealed day is not compared with its checksum
    Mutant("opened", "row is None or not agrees(segment_table, row)", "row is None"),
    # rows of one epoch are lost where a page ends between them
    Mutant("newest_rows", "before[0] + 1", "before[0]"),
    Mutant("SequenceNumbers._advanced", "block.first - tail.last - 1", "block.first - tail.last"),
)
EDGES = (
    # pages leave out the row at which they meet
    Mutant("PageQuery.cut", "found[self.limit - 1]", "found[self.limit]"),
    # a key that has expired opens the service
    Mutant("StoredKeys._holder", "if not stored.key.is_valid(now_us):", "if stored.key.revoked_at_us is not None:"),
    # who was silent for an hour may send without a limit
    Mutant("Bucket.consume", "min(self._tokens + gained, self._burst)", "self._tokens + gained"),
    # rows that the service did not answer for leave the spool
    Mutant("read_receipt", "len(refused) == rows and", "len(refused) <= rows and"),
    # a semicolon within quotes splits an answer
    Mutant("split_answers", 'if letter == ";" and not quote:', 'if letter == ";":'),
    # the offset from UTC with the wrong sign
    Mutant("parse_epoch", "- _offset_us(match)", "+ _offset_us(match)"),
    # an absent figure is exported as "nan"
    Mutant("text_of_float", '"" if math.isnan(value) else repr(float(value))', "repr(float(value))"),
)
MUTANTS = (*CORE, *PIPELINE, *RELEASE, *ARCHIVE, *EDGES)
