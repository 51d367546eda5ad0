"""Import of an operator's own files: read whole, judged, asked about, then stored."""
