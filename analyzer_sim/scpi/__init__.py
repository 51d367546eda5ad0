"""The language: framing of messages, parser, header tree, parameters, errors, status model. No socket, no command."""
