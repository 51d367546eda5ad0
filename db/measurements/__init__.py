"""Measurements (L1): ingest, paging, sealing of closed days, retention."""
