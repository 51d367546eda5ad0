"""Views of the present: status, newest rows, links, hand-over.

Public: catalogue_findings, handover, jobs, links, newest, present, shipped, status, timeline.
"""
