"""Model and state of the attitude filter, and the priors of what it cannot see.

Public: declared, filter_model, filter_state, hidden_motion, measured_motion, polarimeter, sensor_effect, step_inputs,
torque_prior, wheel_momentum.
"""
