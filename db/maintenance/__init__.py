"""Maintenance of an archive: backup, restore, integrity check.

Public: archive_tools.
"""
