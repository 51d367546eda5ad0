"""One spectrum analyzer: settings, sweep, spectrum, detectors, its errors, channel power."""
