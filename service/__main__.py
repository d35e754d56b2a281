"""The command ``bearing-twin``, and ``python -m service``."""

import sys

#: As a shell says it of a command that Ctrl-C ended.
STATUS_INTERRUPTED = 130


def main() -> None:
    """Run the command line; Ctrl-C ends it without a traceback also while it is still loading."""
    try:
        from service.cli import main as run

        run()
    except KeyboardInterrupt:
        sys.exit(STATUS_INTERRUPTED)


if __name__ == "__main__":
    main()
