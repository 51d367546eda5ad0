"""The command line: every command registered here, one group a file."""

import typer

from service.cli.administration.audit import app as audit
from service.cli.administration.backup import app as backup
from service.cli.administration.doctor import doctor
from service.cli.administration.keys import app as keys
from service.cli.administration.serve import serve
from service.cli.administration.upkeep import upkeep
from service.cli.demo import demo
from service.cli.operation.export import export
from service.cli.operation.operate import align, calibrate, replay
from service.cli.planning.plan import plan
from service.cli.reference import openapi, settings
from service.cli.station.acquire import acquire
from service.cli.station.send import send
from service.cli.studies.study import app as study

app = typer.Typer(
    name="soo",
    help="Attitude of a geostationary satellite from the powers of the carriers it retransmits.",
    no_args_is_help=True,
    pretty_exceptions_show_locals=False,
    add_completion=False,
)

for command in (demo, serve, acquire, send, calibrate, align, replay, export, plan, doctor, upkeep, openapi, settings):
    app.command()(command)
app.add_typer(keys, name="keys")
app.add_typer(audit, name="audit")
app.add_typer(backup, name="backup")
app.add_typer(study, name="study")
