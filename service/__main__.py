"""Entry point of ``soo`` and ``python -m service``."""

import gc
import sys


def main() -> None:
    """Run the command line; the service starts without the modules of the other commands, which take half a second."""
    if sys.argv[1:2] == ["serve"]:
        # the collector finds nothing among modules being loaded and takes a seventh of the start to say so; it is back
        # once the service is put together
        gc.disable()
        import typer

        from service.cli.administration.serve import serve

        alone = typer.Typer(pretty_exceptions_show_locals=False, add_completion=False)
        alone.command()(serve)
        alone(args=sys.argv[2:], prog_name="soo serve")
        return
    from service.cli.app import app

    app()


if __name__ == "__main__":
    main()
