"""Protocol of the interface: bodies, epochs, paging, the OpenAPI document.

Public: bodies, byte_ranges, epochs, merge_patch, openapi, paging, reference_page, request_ids.
"""
