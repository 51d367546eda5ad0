"""Entry point of ``soo`` and ``python -m service``."""

import gc
import sys


def main() -> None:
    """Run the command line; end with 2 and the name of the extra where a package of one is missing."""
    # the collector finds nothing among modules being loaded and takes a tenth of the start to say so; it is back when
    # the command begins, for ``serve`` when the service is put together
    gc.disable()
    from service.cli.app import app

    try:
        app()
    except ModuleNotFoundError as error:
        from service.cli.command_group import EXTRA_OF

        extra = EXTRA_OF.get((error.name or "").partition(".")[0])
        if extra is None:
            raise
        sys.stderr.write(f"{error.name} is not installed; install the extra {extra}: pip install 'soo[{extra}]'\n")
        sys.exit(2)


if __name__ == "__main__":
    main()
