"""The processes that a process has started, read from the system while threads and processes come and go."""

from pathlib import Path


def children_of(process_id: int) -> list[int]:
    """Return the ids of the children of all threads of a process; none of a process that has ended."""
    children: list[int] = []
    for task in Path(f"/proc/{process_id}/task").glob("*/children"):
        # a thread may end between the listing and the reading
        try:
            children += map(int, task.read_text().split())
        except (FileNotFoundError, ProcessLookupError):
            continue
    return children


def descendants_of(process_id: int) -> list[int]:
    """Return the ids of the children of a process, and of theirs."""
    own = children_of(process_id)
    return own + [below for child in own for below in descendants_of(child)]
