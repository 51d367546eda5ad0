"""Names in CSV files that a spreadsheet would compute: an apostrophe before them, which is removed on import."""

import re

#: what a spreadsheet takes for a formula, behind any number of our own apostrophes
_FORMULA = re.compile(r"'*[=+\-@\t\r]")


def guarded(text: str) -> str:
    """Return a text, with an apostrophe before it where a spreadsheet would compute it; for names, not for numbers.

    Examples
    --------
    >>> guarded("=HYPERLINK(1)"), guarded("'=1"), guarded("c00")
    ("'=HYPERLINK(1)", "''=1", 'c00')
    """
    return f"'{text}" if _FORMULA.match(text) else text


def unguarded(text: str) -> str:
    """Return the text that `guarded` was given.

    Examples
    --------
    >>> unguarded("'=HYPERLINK(1)"), unguarded("'quoted'"), unguarded("-1")
    ('=HYPERLINK(1)', "'quoted'", '-1')
    """
    return text[1:] if text.startswith("'") and _FORMULA.match(text) else text
