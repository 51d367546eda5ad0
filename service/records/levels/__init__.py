"""Records of the data levels L0 to L5."""
