"""Composition root: settings from the environment, and the parts put together by them.

Public: bootstrap, setting_entries, settings.
"""
