"""Records of operation: alarms, notes, links, keys, releases, jobs."""
