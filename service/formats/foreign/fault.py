"""Errors of tables that other programs wrote."""


class ForeignTableError(ValueError):
    """The table cannot be read as a whole; the text says why and what to do."""


class ForeignCellError(ValueError):
    """A cell means nothing under the stated layout.

    Parameters
    ----------
    kind : str
        Reason, equal for all cells with the same fault.
    cell : object
        The cell.
    """

    def __init__(self, kind: str, cell: object) -> None:
        super().__init__(f"{kind}: {str(cell)[:40]!r}")
        self.kind = kind
