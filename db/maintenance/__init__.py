"""Maintenance of an archive: backup, restore, integrity check."""
