"""Documents of requests and answers, as pydantic models: converted into records and back, independent of HTTP.

Public: alarms, alignments, analyses, archive, attitude, audit, base, calibrations, carrier_results, carrier_selection,
carriers, closed_loop, control, ephemeris, handover, inputs, inspection, jobs, keys, links, measurement_rows,
measurements, notes, operations, replays, spacecraft, status, torque_commands, torques, traces.
"""
