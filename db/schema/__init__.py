"""Tables of the archive and the version of its schema.

Public: access_tables, alarm_tables, column_types, columns, lease_tables, record_columns, release_tables,
row_checksum, schema_version, tables.
"""
