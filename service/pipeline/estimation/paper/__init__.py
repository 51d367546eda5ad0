"""Published method: harmonic removal, snapshot fix, rate filter."""
