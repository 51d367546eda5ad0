"""Context of a request: dependencies and what routes look up in common.

Public: carrier_names, commit_waiter, dependencies, epoch_limits, method_parameters, monitoring_settings,
plan_widths.
"""
