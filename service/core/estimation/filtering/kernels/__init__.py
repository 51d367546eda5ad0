"""Arithmetic of the attitude filter, as numpy runs it or compiled."""
