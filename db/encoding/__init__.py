"""Encoding of rows: packed powers, sealed days as Parquet, JSON documents."""
