"""Live chain: leadership, journal consumer, row publisher.

Public: journal_consumer, leadership, live_feed, row_watchers, supervisor.
"""
