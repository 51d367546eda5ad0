"""Client of the REST interface.

Public: archive_download, backoff, documents, problem, service_client.
"""
