"""Control (L5): computed commands and the release of torques."""
