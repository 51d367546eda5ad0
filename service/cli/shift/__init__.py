"""Commands of a shift: read the state, answer alarms, order control, release torques, hand over, watch."""
