"""Inputs beside powers: known motion, declared operations, sensor angles, weather reports, polarimeters."""
