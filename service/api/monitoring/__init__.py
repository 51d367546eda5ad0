"""Monitoring of the service: metrics, access log, readiness.

Public: access_log, metrics, readiness, request_metrics.
"""
