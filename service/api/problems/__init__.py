"""Problems (RFC 9457): codes, validation errors, handlers.

Public: handlers, problems, validation_errors.
"""
