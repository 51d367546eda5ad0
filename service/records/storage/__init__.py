"""Records about the archive itself: maintenance, backups, diagnoses.

Public: archive_maintenance, backup, diagnosis, storage_state.
"""
