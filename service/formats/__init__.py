"""Writers and readers of archive formats: bytes in, bytes out.

Public: aem, carrier_plan_csv, numbers, tdm.
"""
