"""Backfill: archive files sent to the service in resumable pieces.

Public: backfill, columns, reader, survey.
"""
