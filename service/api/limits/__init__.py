"""Limits of requests: rates, body sizes, HTTP heads.

Public: body_limit, connections, http_protocol, rate_limits.
"""
