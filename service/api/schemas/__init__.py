"""Documents that come in and go out, as pydantic models; they turn into records and back, and know nothing of HTTP.

Public: alarms, alignments, analyses, archive, attitude, audit, base, calibrations, carrier_selection, carriers,
closed_loop, control, ephemeris, handover, inputs, inspection, jobs, keys, links, measurement_rows, measurements,
notes, operations, replays, spacecraft, status, torque_commands, torques, traces.
"""
