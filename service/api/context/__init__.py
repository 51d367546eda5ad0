"""Context of a request: dependencies and what routes look up in common."""
