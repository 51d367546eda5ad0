"""Watches of the attitude filter: tests of its assumptions that run beside it."""
