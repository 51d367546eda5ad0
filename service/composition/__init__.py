"""Composition root: settings from the environment, and the parts put together by them."""
