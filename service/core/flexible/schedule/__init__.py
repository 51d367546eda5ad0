"""Check of a torque schedule against the flexible modes of one axis."""
