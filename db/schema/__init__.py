"""Tables of the archive and the version of its schema."""
