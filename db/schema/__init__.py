"""Tables of the archive and the number of their layout."""
