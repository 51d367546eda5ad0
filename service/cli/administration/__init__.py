"""Commands of an administrator: init, serve, keys, backup, maintenance, doctor, audit."""
