"""Measurements (L1): ingest, paging, sealing of closed days, retention.

Public: archive, checksum_check, journal_heads, measurement_pages, power_summaries, retention, slow_inputs.
"""
