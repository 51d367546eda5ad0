"""``soo study``: campaigns on simulated truth and reproductions of papers."""

from service.cli.command_group import CommandSource, late_app

_COMMANDS = {
    "orbital-frame": CommandSource(
        "studies.papers", "Fly the orbital-frame model and print its figures beside the published ones."
    ),
    "limit-cycles": CommandSource(
        "studies.papers", "Reproduce limit cycles, capture and torque schedules of a flexible spacecraft."
    ),
    "closed-loop": CommandSource(
        "studies.closed_loop",
        "Close the loop with the chain, beside perfect sensing and beside no control, which must fail.",
    ),
    "rf-attitude": CommandSource(
        "studies.papers",
        "Fit the published daily curve and compare sessions with other sensors, beside the published figures.",
    ),
    "estimation": CommandSource(
        "studies.estimation", "Run both methods over simulated worlds and hold their figures against the bounds."
    ),
}

app = late_app(_COMMANDS, help="Campaigns on simulated truth and reproductions of papers.")
