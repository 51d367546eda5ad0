"""Live stream: events, ids, backlog."""
