"""Alarm service: alarm engine over the archive, notifications by mail and webhook.

Public: alarm_service, mail, notifications, webhook.
"""
