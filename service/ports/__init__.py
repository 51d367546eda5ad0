"""Ports: what the inside of the service asks of the outside. Adapters implement them; nothing here imports one.

``Archive`` holds the promise of the product: when an append returns a receipt, what it counts as accepted is durable,
visible and counted once. Every call may raise StorageError, for example ``storage.corrupt`` when a sealed day that it
needs is damaged. Unknown names raise NotFoundError with the codes
``spacecraft.unknown``, ``plan.unknown``, ``ephemeris.unknown``, ``calibration.unknown``, ``alignment.unknown``,
``operation.unknown``, ``source.unknown``, ``job.unknown``, ``replay.unknown``, ``link.unknown``, ``key.unknown``.

While a request has an audit note (``service.records.operations.access.CURRENT_NOTE``), the first write that it waits
for commits its audit entry together with the change.
"""
