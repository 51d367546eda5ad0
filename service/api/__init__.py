"""REST interface, version 1.

Public: app, server_process.
"""
