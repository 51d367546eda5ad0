"""Measurement functions on a trace: powers of bands, markers, power list.

Public: band_power, function_settings, markers, occupied_bandwidth, power_list.
"""
