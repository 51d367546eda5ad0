"""Plant: a world whose operation phase is flown by commanded torques."""
