"""Commands of a measuring station: acquire, send.

Public: tdm_archive.
"""
