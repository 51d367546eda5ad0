"""Torque command of a row: law, allocation, inhibitions, schedule check."""
