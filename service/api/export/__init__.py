"""Export of the archive over HTTP: files by day, ranges, streams."""
