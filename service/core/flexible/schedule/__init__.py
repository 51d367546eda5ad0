"""Check of a torque schedule against the flexible modes of one axis.

Public: schedule_check, schedule_metrics, schedule_response.
"""
