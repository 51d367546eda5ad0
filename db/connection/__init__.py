"""Connections to the archive's database: engines, the single writer, the leases of leaders.

Public: engines, file_identity, lease, prepared_statements, row_insertion, server_leases, sqlite_files, writer.
"""
