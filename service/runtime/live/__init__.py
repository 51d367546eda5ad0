"""Live chain: leadership, journal consumer, row publisher."""
