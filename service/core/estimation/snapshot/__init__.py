"""Attitude of one epoch alone, robust against several wrong carriers."""
