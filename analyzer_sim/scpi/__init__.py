"""The language: framing of messages, parser, header tree, parameters, errors, status model. No socket, no command.

Public: errors, framing, parameters, parser, status, tree.
"""
