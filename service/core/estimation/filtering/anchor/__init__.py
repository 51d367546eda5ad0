"""Anchor of the attitude filter: the references of the alignment, and what they say of the filter's error."""
