"""Documents that come in and go out, as pydantic models; they turn into records and back, and know nothing of HTTP."""
