"""``soo study rf-attitude``: attitude from retransmitted carriers on Yamal-200 beside its published figures.

Exit codes: 0 every figure but those that are known not to reproduce does, 1 another one does not, 2 nothing was run.
"""

from typing import Annotated

import typer

from service.cli.studies.published import report
from service.cli.studies.screen import EXIT_MISSED, AsJson, AsMarkdown, Figures, draw, failures_shown, named_steps


def rf_attitude(
    seeds: Annotated[int, typer.Option(min=1, max=100, help="Simulated worlds 1 to this number.")] = 2,
    as_json: AsJson = False,
    as_markdown: AsMarkdown = False,
    figures: Figures = None,
) -> None:
    """Fit the published daily curve and compare sessions with other sensors, beside the published figures."""
    from service.study.estimation.flight.drive import UndrivenError
    from service.study.estimation.flight.world import ExportFailedError
    from service.study.rf_attitude.reproduction import reproduce

    with failures_shown(ExportFailedError, UndrivenError, OSError), named_steps() as show:
        rows, sessions = reproduce(seeds, show)
    draw(figures, "rf_attitude", lambda study, at: study.draw_reproduction(sessions[0], at))
    report(rows, "Attitude from retransmitted carriers, Yamal-200", as_json=as_json, as_markdown=as_markdown)
    if any(one.is_surprising for one in rows):
        raise typer.Exit(EXIT_MISSED)
