"""Tables of other programs: their separators, decimals, epochs, units and columns; nothing is guessed silently.

Public: attitude_message, fault, layout, orbit_file, parquet_table, proposal, sensor, text_table.
"""
