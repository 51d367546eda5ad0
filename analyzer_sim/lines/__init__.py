"""Raw sockets and HiSLIP: sessions, dispatch, locks, faults of the line."""
