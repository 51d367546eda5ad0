"""The attitude filter: prediction, common changes, carrier faults, rain, integrity.

Public: attitude_filter, carry_over, filter_records, filter_update, hidden_shares.
"""
