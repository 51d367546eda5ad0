"""Backfill: archive files sent to the service in resumable pieces."""
