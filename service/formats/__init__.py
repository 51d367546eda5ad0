"""Writers and readers of archive formats: bytes in, bytes out."""
