"""Ground: what the operators of a simulated satellite know and send.

Public: ground, ground_bodies, ground_port.
"""
