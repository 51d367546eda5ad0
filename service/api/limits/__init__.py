"""Limits of requests: rates, body sizes, HTTP heads."""
