"""``soo demo``: the whole chain on a virtual clock, and its screen."""
