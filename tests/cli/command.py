"""The command line for tests: in this process, where only what it does is asked; as a process of its own, where more is."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from unittest.mock import patch

from keypose.cli import main

ENVIRONMENT = {"COLUMNS": "100", "NO_COLOR": "1"}


@dataclass(frozen=True)
class Done:
    """What is left of a command."""

    returncode: int
    stdout: str
    stderr: str


def keypose(*arguments: object) -> Done:
    """Run the command in this process, through the same entrance, printing and exit codes as from a shell."""
    out, err = io.StringIO(), io.StringIO()
    words = ["keypose", *map(str, arguments)]
    code: object = 0
    with (
        patch.dict(os.environ, ENVIRONMENT),
        patch.object(sys, "argv", words),
        patch.object(sys, "excepthook", sys.excepthook),  # the command's own is taken back
        redirect_stdout(out),
        redirect_stderr(err),
    ):
        try:
            main()
        except SystemExit as end:
            code = end.code
    assert isinstance(code, int), code
    return Done(code, out.getvalue(), err.getvalue())


def process(*arguments: object) -> Done:
    """Run the command as a process of its own: a second and more, most of it for importing what is imported here already."""
    command = [sys.executable, "-m", "keypose", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, env={**os.environ, **ENVIRONMENT})
    return Done(done.returncode, done.stdout, done.stderr)


def refused(done: Done) -> str:
    """The one line of an error; no traceback, exit code 1."""
    assert done.returncode == 1, done.stderr + done.stdout
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1 and lines[0].startswith("error: "), done.stderr
    return lines[0]
