"""The verdict on control: whether a torque may go now, in which state, and every reason with its next step.

Every answer about the present carries this one object.
"""

from service.pipeline.control.release.control_reasons import reason_of
from service.pipeline.control.release.interlock_conditions import Condition, Consequence
from service.pipeline.control.release.interlock_states import State
from service.records.catalogue import Release
from service.records.levels.attitude import AttitudeRow
from service.records.levels.command import TorqueCommand
from service.records.operations.release import ControlVerdict, ControlView

#: states in which torques go, by hand or by themselves
_GIVING = frozenset({State.ARMED.name, State.ENGAGED.name, State.RECOVERY.name})
#: reasons that withhold yaw alone
_YAW_ONLY = frozenset(each.word for each in Condition if each.consequence is Consequence.YAW)


def control_verdict(view: ControlView | None, newest: TorqueCommand | AttitudeRow | None) -> ControlVerdict:
    """Return the verdict on control.

    Parameters
    ----------
    view : ControlView or None
        Interlock; None: it cannot be read, which forbids control.
    newest : TorqueCommand or AttitudeRow or None
        Newest command of the method that drives control as it holds now, else its newest row; None: neither exists.

    Returns
    -------
    ControlVerdict
        Allowed when neither interlock nor row forbids. In release ``automatic`` nobody arms: the state is ENGAGED
        while allowed.
    """
    found = {} if view is None else {reason.code: reason for reason in view.reasons}
    if view is None:
        found["release_unreadable"] = reason_of("release_unreadable")
    # the interlock itself tells by what it has tripped
    inhibitions = ("no_attitude",) if newest is None else tuple(one for one in newest.inhibitions if one != "tripped")
    for code in inhibitions:
        found.setdefault(code, reason_of(code))
    if inhibitions:
        # the row's own reasons say the same in full
        found.pop(Condition.ESTIMATOR.word, None)
    is_forbidden = not _YAW_ONLY.issuperset(found)
    state = State.INHIBITED.name if view is None else view.state
    if view is not None and view.release == Release.AUTOMATIC and state != State.TRIPPED.name:
        state = State.INHIBITED.name if is_forbidden else State.ENGAGED.name
    return ControlVerdict(state in _GIVING and not is_forbidden, state, tuple(found.values()))
