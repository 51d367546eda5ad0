"""Front end: measurement task, analyzer session, carrier powers, upload.

Public: link_report, measurement_task, station.
"""
