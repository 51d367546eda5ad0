"""Problems (RFC 9457): codes, validation errors, handlers.

Public: handlers, next_steps, problems, validation_errors.
"""
