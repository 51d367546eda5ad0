"""Commands of a measuring station: acquire, send.

Public: state_folder.
"""
