"""Rows and evidence traces on the front end's disk until the service has them.

Public: file, row, schema, spool.
"""
