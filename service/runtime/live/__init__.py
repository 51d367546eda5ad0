"""Live chain: leadership, journal consumer, row publisher.

Public: chain_restart, journal_consumer, leadership, live_feed, row_watchers, supervisor.
"""
