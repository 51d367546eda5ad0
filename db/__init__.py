"""Relational storage: tables, engine, mapping row to record, repositories."""
