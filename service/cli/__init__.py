"""Command line, one command group a file."""
