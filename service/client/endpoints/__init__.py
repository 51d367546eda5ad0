"""The REST contract as methods: each endpoint is written once, for the blocking and for the awaiting client.

Nothing is interpreted here; epochs go in as RFC 3339 text or as int64 microseconds UTC, answers come as the
dictionaries of the contract. Errors are those of `service.client.problem`.
"""
