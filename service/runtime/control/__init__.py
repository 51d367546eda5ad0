"""Release service: interlock and torque commands over the archive."""
