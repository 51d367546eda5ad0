"""Problems (RFC 9457): codes, validation errors, handlers."""
