"""Rows as CSV, NDJSON and Parquet.

Public: joined_table, measurement_file, row_text, series_tables, table_file.
"""
