"""Commands of a measuring station: acquire, send."""
