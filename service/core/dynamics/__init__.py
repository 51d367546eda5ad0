"""Closed-loop attitude dynamics in the orbital frame of the Meteor-M papers.

Axes here, and only here: z along the radius vector (up), y along the orbital angular velocity, x = y x z in flight; yaw
turns about up. The service's axes (x East, y South, z nadir) have roll alike, pitch and yaw reversed.
"""
