"""Schema migrations.

Public: migrate.
"""
