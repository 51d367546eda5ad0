"""Connections to the archive's database: engines, the single writer, the lease of the leader.

Public: engines, file_identity, lease, prepared_statements, sqlite_files, storage_state, writer.
"""
