"""Live stream: events, ids, backlog.

Public: event_ids, event_stream, open_streams.
"""
