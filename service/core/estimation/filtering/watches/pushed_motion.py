"""Pushed motion: how far a torque turns the spacecraft within two hours if nothing is commanded.

Zero torque is no neutral action: where a disturbance acts, this is the price of waiting, the unknown part among it. The
error that the estimate has now does not, for control would not remove that either, nor does what would happen
without the torque: it comes slowly, and while it does nothing is lost.
"""

import numpy as np

from service.core.estimation.filtering.model.filter_model import CarrierModel, FilterSettings, FloatArray, no_motion
from service.core.estimation.filtering.model.filter_state import ATTITUDE, Gaussian
from service.core.estimation.filtering.model.hidden_motion import hidden_transition, sensor_states, sensors_first
from service.core.estimation.filtering.model.torque_prior import TORQUES, is_pushed

#: two hours, the period of the control law
_HORIZON_US = 7200 * 10**6
_SIGMAS = 2.0


def pushed_deg(model: CarrierModel, settings: FilterSettings, state: Gaussian, epoch_us: int) -> FloatArray:
    """Return the size (3,) that yaw, roll and pitch gain by the torque, deg: the mean and two sigmas.

    Parameters
    ----------
    model : CarrierModel
        The carriers.
    settings : FilterSettings
        The spacecraft.
    state : Gaussian
        State of the filter.
    epoch_us : int, microseconds UTC
        Of the state.
    """
    if not is_pushed(settings):
        return np.zeros(3)
    stop, hidden = sensors_first(model, state, settings), TORQUES + sensor_states(settings)
    response = hidden_transition(hidden, epoch_us, _HORIZON_US, settings, no_motion())[ATTITUDE, :TORQUES]
    torque = slice(stop - TORQUES, stop)
    variance = np.diagonal(response @ state.covariance[torque, torque] @ response.T)
    return np.asarray(np.abs(response @ state.mean[torque]) + _SIGMAS * np.sqrt(np.maximum(variance, 0.0)))
