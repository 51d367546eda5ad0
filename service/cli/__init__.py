"""Command line, one command group a file.

Public: app, extras.
"""
