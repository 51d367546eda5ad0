"""Connections to the archive's database: engines, the single writer, the lease of the leader."""
