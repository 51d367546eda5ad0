"""Tables of other programs: their separators, decimals, epochs, units and columns; nothing is guessed silently."""
