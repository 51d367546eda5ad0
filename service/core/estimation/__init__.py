"""Harmonic, octants, sensitivity, snapshot fix, observability."""
