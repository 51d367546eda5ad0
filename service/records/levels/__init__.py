"""Records of the data levels L0 to L5.

Public: attitude, carrier_results, command, disturbance, measurement, measurement_block, quality_flag, series, sweep,
trace.
"""
