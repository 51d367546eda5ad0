"""Encoding of rows: powers as bytes, sealed days as Parquet, JSON documents."""
