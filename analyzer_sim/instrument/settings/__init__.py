"""Settings of the analyzer: limits, couplings and the makers' models."""
