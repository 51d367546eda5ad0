"""Measurement functions on a trace: powers of bands, markers, power list."""
