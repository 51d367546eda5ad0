"""Monitoring of the service: metrics, access log, readiness."""
