"""A row of the attitude filter after its prediction: its stages, compiled or one by one.

Public: row_kernels, row_stages, staged_row.
"""
