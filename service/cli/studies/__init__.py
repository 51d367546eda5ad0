"""Commands `soo study ...`.

Public: exit_code.
"""
