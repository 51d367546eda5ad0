"""From the spool to the service: lanes, answers, binding of rows to carrier plans."""
