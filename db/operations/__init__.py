"""Operations: catalogue, alarms, notes, torque releases, links, keys, audit.

Public: alarms, audit, catalogue, keys, links, notes, releases, traces.
"""
