"""Flight of the chain over one simulated world of the estimation study."""
