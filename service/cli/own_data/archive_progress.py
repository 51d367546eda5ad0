"""Progress of an archive that is sent, as a bar on a terminal."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from service.client.service_client import ServiceClient
    from service.frontend.backfill import backfill


def send_with_progress(client: "ServiceClient", order: "backfill.ArchiveOrder", *, is_quiet: bool) -> dict[str, Any]:
    """Send behind a progress bar; away from a terminal it would be noise."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    from service.frontend.backfill.backfill import send_archive

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    bar = Progress(*columns, TextColumn("{task.fields[rate]}"), console=console)
    bar.disable = is_quiet or not console.is_terminal
    with bar:
        task = bar.add_task(order.path.name, total=None, rate="")
        begun_at = bar.get_time()
        first: list[int] = []

        def show(progress: "backfill.Progress") -> None:
            first.append(progress.rows) if not first else None
            rate = (progress.rows - first[0]) / max(bar.get_time() - begun_at, 1e-3)
            bar.update(task, completed=progress.done, total=progress.total, rate=f"{rate:,.0f} rows/s")

        return send_archive(client, order, show)
