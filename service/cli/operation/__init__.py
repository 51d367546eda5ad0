"""Commands of an operator: calibrate, align, replay, export; their connection and the user's profile."""
