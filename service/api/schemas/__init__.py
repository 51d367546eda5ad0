"""Documents of requests and answers, as pydantic models: converted into records and back, independent of HTTP."""
