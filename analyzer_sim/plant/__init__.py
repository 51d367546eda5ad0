"""Plant: a world whose operation phase is flown by commanded torques.

Public: change_port, flown_world, plant, plant_lines, uplink_port.
"""
