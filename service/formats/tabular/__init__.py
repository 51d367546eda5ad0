"""Rows as CSV, NDJSON and Parquet.

Public: measurement_file, row_text, series_tables, table_file.
"""
