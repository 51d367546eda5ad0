"""Pure mathematics: float64 arrays in, arrays or named tuples out."""
