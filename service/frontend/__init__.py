"""Front end: measurement task, analyzer session, carrier powers, upload."""
