"""Tables of the archive and the number of their layout.

Public: access_tables, alarm_tables, layout, lease_tables, record_columns, release_tables, row_checksum, tables.
"""
