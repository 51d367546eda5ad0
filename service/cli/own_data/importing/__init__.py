"""Import of a folder: a manifest proposed from its files, compared with the service, and sent."""
