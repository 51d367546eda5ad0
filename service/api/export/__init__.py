"""Export of the archive over HTTP: files by day, ranges, streams.

Public: export_chunks, export_files, export_responses.
"""
