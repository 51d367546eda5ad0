"""SOO: attitude of a geostationary satellite from the powers of the carriers it retransmits."""
