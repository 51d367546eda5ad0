"""Entry point of ``soo`` and ``python -m service``."""

import gc
import sys

#: third-party packages of an extra, by the name under which they are imported
_EXTRA_OF = {"matplotlib": "study", "pyvisa": "station", "pyvisa_py": "station"}


def main() -> None:
    """Run the command line; end with 2 and the name of the extra where a package of one is missing."""
    # the collector finds nothing among modules being loaded and takes a tenth of the start to say so; it is back when
    # the command begins, for ``serve`` when the service is put together
    gc.disable()
    from service.cli.app import app

    try:
        app()
    except ModuleNotFoundError as error:
        extra = _EXTRA_OF.get((error.name or "").partition(".")[0])
        if extra is None:
            raise
        sys.stderr.write(
            f"{error.name} is not installed; install it with the extra {extra}: pip install 'soo[{extra}]'\n"
        )
        sys.exit(2)


if __name__ == "__main__":
    main()
