"""Live supervisor, replay, jobs, live feed and the only readers of time."""
