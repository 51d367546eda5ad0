"""Studies: demonstrations and campaigns on simulated truth."""
