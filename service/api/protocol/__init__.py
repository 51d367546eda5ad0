"""Protocol of the interface: bodies, epochs, paging, the OpenAPI document."""
