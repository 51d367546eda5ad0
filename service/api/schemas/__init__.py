"""Documents of requests and answers, as pydantic models: converted into records and back, independent of HTTP.

Public: about, alarms, alignments, analyses, archive, attitude, audit, base, beams, calibrations, carrier_results,
carrier_selection, carriers, closed_loop, control, ephemeris, handover, inputs, inspection, jobs, keys, links,
live_method, measurement_rows, measurements, notes, operations, replays, samples, session, spacecraft, status, timeline,
torque_commands, torques, traces.
"""
