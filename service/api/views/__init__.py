"""Views of the present: status, newest rows, links, hand-over.

Public: catalogue_findings, handover, links, newest, present, status.
"""
