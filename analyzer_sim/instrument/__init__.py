"""One spectrum analyzer: settings, sweep, spectrum, detectors, its errors, what it measures on a trace."""
