"""Records about the archive itself: maintenance, backups, diagnoses."""
