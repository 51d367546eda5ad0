"""Connections to the archive's database: engines, the single writer, the leases of leaders."""
