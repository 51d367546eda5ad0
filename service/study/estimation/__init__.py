"""Campaign of the estimation: both methods over the simulator's worlds, judged by the bounds that were set for them."""
