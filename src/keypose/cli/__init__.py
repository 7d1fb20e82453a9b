"""The `keypose` command: verbs over files, with clear errors and progress bars."""

from __future__ import annotations

import os
import sys


def main() -> None:
    """Run the command line; bad input prints one line and exits with 1, wrong usage exits with 2."""
    from keypose.cli.app import app
    from keypose.errors import KeyposeError

    try:
        app(prog_name="keypose")
    except KeyposeError as error:
        _fail(str(error))
    except BrokenPipeError:  # the reader of our output went away (`keypose info … | head`)
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(141) from None
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        _fail(f"{where}{error.strerror or error}")
    except MemoryError:
        _fail("not enough memory for this input")


def _fail(message: str) -> None:
    print(f"error: {' '.join(message.split())}", file=sys.stderr)
    raise SystemExit(1)
