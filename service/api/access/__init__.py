"""Access: keys, roles, the audit trail of refused requests."""
