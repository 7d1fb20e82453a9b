"""`keypose demo`, `studio` and `play`."""

from __future__ import annotations

import sys
from pathlib import Path

from keypose.errors import FormatError


def open_studio(references: list[str], *, host: str, port: int, open_browser: bool, allow_remote: bool) -> None:
    """Serve the studio until Ctrl-C; prints its URL once it listens.

    Raises:
        FormatError: where a file is not there.
    """
    from keypose.samples.graphs import names

    for reference in references:  # a wrong path is told before anything is started
        if not reference.startswith("sample:") and reference not in names() and not Path(reference).is_file():
            what = "is a folder; expected a file" if Path(reference).is_dir() else "no such file"
            raise FormatError(what, path=reference)
    from keypose.studio import server

    def ready(url: str) -> None:
        print(f"keypose studio: {url}", flush=True)
        if sys.stdout.isatty():
            print("Ctrl-C stops it.", flush=True)

    server.serve(references, host=host, port=port, open_browser=open_browser, ready=ready, allow_remote=allow_remote)
