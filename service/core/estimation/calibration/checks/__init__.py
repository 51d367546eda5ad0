"""Checks of a calibration: axes of the sensors, places of the stations.

Public: angle_response, feed_turn, free_response, momentum_response, rate_response, sensor_axes, station_check.
"""
