"""Encoding of rows: packed powers, sealed segments, JSON documents.

Public: carrier_codec, column_codec, json_documents, measurement_details, measurement_runs, power_codec, row_content,
row_mapping, segment_codec, segments, stored_summaries, summary_codec.
"""
