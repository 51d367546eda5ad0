"""Robust method: attitude filter over all carriers."""
