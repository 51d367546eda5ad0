"""Rows and evidence traces on the front end's disk until the service has them."""
