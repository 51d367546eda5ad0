"""A row in which something is found or declared, stage by stage, in Python.

The stages are those of `row_stages`; what the row gives cause for is done between them: the unknown of a common cause
is set free, failed carriers are set aside, commands are judged. The law of this file: common first, carriers next.
"""

from typing import NamedTuple

import numpy as np

from service.core.estimation.filtering.causes.carrier_faults import SAME_LEVEL_DB, flag_failed
from service.core.estimation.filtering.causes.common_cause import NOTHING, SUDDEN_CHANGE, widen
from service.core.estimation.filtering.causes.fault_hypotheses import Cause, Chooser, LikeliestCause
from service.core.estimation.filtering.causes.rain_state import RainWatch
from service.core.estimation.filtering.declared_effects import is_chain_worked
from service.core.estimation.filtering.filter_records import FilterState
from service.core.estimation.filtering.filter_update import innovate
from service.core.estimation.filtering.model.declared import Declared
from service.core.estimation.filtering.model.filter_model import (
    BoolArray,
    CarrierModel,
    FilterSettings,
    FloatArray,
    IntArray,
)
from service.core.estimation.filtering.model.filter_state import CHAIN
from service.core.estimation.filtering.model.hidden_motion import with_doubted_torque
from service.core.estimation.filtering.model.torque_prior import is_pushed, torque_size_deg_h2
from service.core.estimation.filtering.rows.row_stages import (
    ClosedRow,
    OrdinaryRow,
    ScreenedRow,
    UsedRow,
    close_row,
    screen_row,
    use_row,
)
from service.core.estimation.filtering.watches.command_watch import (
    is_share_likelier,
    judge_commands,
    push_row,
    without_evidence,
)
from service.core.estimation.filtering.watches.minute_sums import empty_minute
from service.core.estimation.filtering.watches.motion_watch import (
    follow_all,
    newly_explained,
    with_alarms,
    with_explained,
)


class JudgedRow(NamedTuple):
    """Row with the known motion and declarations of its step."""

    #: (N,) dB, NaN = absent or masked
    deviation_db: FloatArray
    #: (n,) carriers to be judged
    present: IntArray
    #: (N,) carriers that are there, or that nobody expects
    is_accounted: BoolArray
    minutes: float
    declared: Declared | None
    #: (N,) 1 where rain over the station is reported, 0 where none is, NaN where nobody says; None = of no station
    reported_wet: FloatArray | None = None


def staged_row(
    model: CarrierModel,
    settings: FilterSettings,
    ahead: FilterState,
    row: JudgedRow,
    white_db2: FloatArray,
    chooser: Chooser,
) -> tuple[OrdinaryRow, Cause | None]:
    """Return a row taken stage by stage, with what the ground or the row itself gives cause for between them."""
    deviation_db = row.deviation_db
    screened = screen_row(model, ahead, deviation_db, row.present, white_db2)
    freed, cause = _screened(model, ahead, screened, row, chooser)
    is_shared = cause is not None and cause is not Cause.INDEPENDENT
    innovation, values, is_minute = screened.innovation, screened.values, screened.is_minute
    if is_shared:
        innovation = innovate(model, freed.gaussian, deviation_db, row.present, white_db2)
        values, is_minute = np.full(model.carriers, np.nan), False
    used = use_row(model, freed, deviation_db, innovation, row.is_accounted, row.minutes, values, is_shared)
    if used.is_moving or used.is_doubted or used.is_failed:
        used = _with_findings(model, settings, ahead, freed, used)
    closed = close_row(
        model,
        freed,
        used,
        freed.rain,
        settings.drift_deg_h,
        deviation_db,
        white_db2,
        _undeclared(values, row.declared),
        is_minute,
        row.minutes,
    )
    after = freed._replace(
        gaussian=closed.gaussian,
        carriers=closed.carriers,
        noise=closed.noise,
        rain=_declared_base(closed, row.declared),
        anchor=closed.anchor,
        drift=closed.drift,
        motion=used.motion,
        command=used.command,
    )
    innovation_db = np.full(model.carriers, np.nan)
    innovation_db[row.present] = screened.innovation.innovation_db
    carriers, is_due, is_returning = used.kept.carriers, closed.is_due, closed.is_returning
    found = OrdinaryRow(False, after, innovation_db, carriers, closed.residual_db, is_due, is_returning, used.effective)
    return found, cause


def _screened(
    model: CarrierModel, ahead: FilterState, screened: ScreenedRow, row: JudgedRow, chooser: Chooser
) -> tuple[FilterState, Cause | None]:
    """Return the state after the tests of all carriers together, the unknown of their cause set free, and the cause."""
    if screened.suspicion == NOTHING:
        return ahead._replace(minute=screened.minute, rain=screened.rain), None
    choice = LikeliestCause(Cause.COMMON)
    if screened.suspicion == SUDDEN_CHANGE:
        choice = chooser(model, screened.innovation)
    if choice.cause is Cause.INDEPENDENT:
        # what single carriers did says nothing about the common level
        return ahead._replace(minute=screened.minute), choice.cause
    widened = widen(
        model,
        ahead.gaussian,
        ahead.carriers,
        screened.rain,
        choice,
        screened.common,
        is_chain_worked=is_chain_worked(row.declared),
    )
    freed = ahead._replace(
        gaussian=widened.gaussian,
        carriers=widened.carriers,
        rain=widened.rain,
        motion=follow_all(ahead.motion) if choice.cause is Cause.ATTITUDE else ahead.motion,
        minute=empty_minute(model.carriers + 1, ahead.epoch_us),
    )
    return freed, choice.cause


def _with_findings(
    model: CarrierModel, settings: FilterSettings, ahead: FilterState, freed: FilterState, used: UsedRow
) -> UsedRow:
    """Return the used row after what it found: motion of its own, commands that are not obeyed, failed carriers."""
    gaussian, motion, command = used.gaussian, used.motion, used.command
    # a torque that was called small, about a spacecraft that is turned by torques, explains motion as one that was not
    unknown_deg_h2 = np.array(settings.unknown_torque_deg_h2)
    is_small = torque_size_deg_h2(settings) < unknown_deg_h2
    is_explained = is_pushed(settings) and (not is_small.any() or command.is_by_torque)
    # one that nobody knows may have changed, as at the edge of a shadow
    unproven = (unknown_deg_h2 > 0.0) & is_explained & (not motion.alarms.any())
    if used.is_moving:
        motion = with_alarms(motion, is_pushed=is_explained)
        axes = newly_explained(freed.motion, motion)
        if is_explained and axes.any():
            # what is wrong about one axis is so about all
            axes, unproven = axes | unproven, np.zeros(3, dtype=np.bool_)
            gaussian, command = with_doubted_torque(model, gaussian, settings, axes), without_evidence(command)
        command = push_row(model, command, used.kept, gaussian.covariance, is_shared=False)
    if used.degrees:
        if unproven.any() and is_share_likelier(command):
            # a torque explains as much as a command that is not obeyed, and is the likelier
            motion = with_explained(motion, unproven)
            gaussian, command = with_doubted_torque(model, gaussian, settings, unproven), without_evidence(command)
        command, gaussian = judge_commands(command, gaussian)
    gaussian, carriers = flag_failed(model, gaussian, used.carriers, ahead.gaussian)
    return used._replace(gaussian=gaussian, motion=motion, command=command, carriers=carriers)


def _declared_base(closed: ClosedRow, declared: Declared | None) -> RainWatch:
    """Return the watch on rain: a fall that begins at a declared step is counted from where the chain stands now."""
    if declared is None or declared.chain_step_db <= SAME_LEVEL_DB:
        return closed.rain
    return closed.rain._replace(base_chain_db=float(closed.gaussian.mean[CHAIN]))


def _undeclared(values: FloatArray, declared: Declared | None) -> FloatArray:
    """Return the test values (N,) from which noise is learned: none of carriers whose noise is declared."""
    return values if declared is None else np.where(declared.white_db > 0.0, np.nan, values)
