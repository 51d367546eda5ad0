"""Rows as CSV, NDJSON and Parquet."""
