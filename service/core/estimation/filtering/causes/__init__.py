"""Causes of a changed level: one carrier, a transponder, rain, the receiving chain.

Public: carrier_faults, carrier_return, common_cause, common_change, fault_hypotheses, rain_state.
"""
