"""Records about the archive itself: maintenance, backups, diagnoses.

Public: archive_maintenance, backup, checkpoint, diagnosis, storage_state.
"""
