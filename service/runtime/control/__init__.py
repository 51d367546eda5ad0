"""Release service: interlock and torque commands over the archive.

Public: automatic_release, release_publisher, release_service.
"""
