"""Alarm service: alarm engine over the archive, notifications by mail and webhook."""
