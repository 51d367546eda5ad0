"""Client of the REST interface."""
