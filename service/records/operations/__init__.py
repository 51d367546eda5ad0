"""Records of operation: alarms, notes, links, keys, releases, jobs.

Public: access_key, alarm, alarm_limits, alarm_memory, audit, job, link, note, release.
"""
