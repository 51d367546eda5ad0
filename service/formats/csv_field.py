"""One field of CSV by RFC 4180."""

import re

#: what separates fields or lines
_SEPARATES = re.compile('[,"\r\n]').search


def csv_field(text: str) -> str:
    r"""Return a field, quoted when it holds what separates fields or lines.

    Examples
    --------
    >>> csv_field('a "b", c')
    '"a ""b"", c"'
    """
    if _SEPARATES(text):
        return '"' + text.replace('"', '""') + '"'
    return text
