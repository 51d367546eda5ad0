"""Commands of an administrator: serve, keys, backup, maintenance, doctor, audit."""
