"""Commands `soo study ...`."""
