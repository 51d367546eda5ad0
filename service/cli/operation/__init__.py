"""Commands of an operator: calibrate, align, replay, export.

Public: connection.
"""
