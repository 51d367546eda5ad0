"""SCPI dialects of the makers' analyzers: tables of commands, queries and answers."""
