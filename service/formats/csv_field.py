"""One field of CSV by RFC 4180."""


def csv_field(text: str) -> str:
    r"""Return a field, quoted when it holds what separates fields or lines.

    Examples
    --------
    >>> csv_field('a "b", c')
    '"a ""b"", c"'
    """
    if any(mark in text for mark in ',"\r\n'):
        return '"' + text.replace('"', '""') + '"'
    return text
