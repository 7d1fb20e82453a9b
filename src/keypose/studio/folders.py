"""What a page's dialog to open or save shows of a folder: its folders and the projects in it, nothing else."""

from __future__ import annotations

import os
from pathlib import Path

from keypose.errors import FormatError
from keypose.project.file import SUFFIX
from keypose.studio.edit_messages import FolderFile, ProjectFolder

MOST_ENTRIES = 2000


def listing(folder: str) -> ProjectFolder:
    """The folders and projects of a folder, by name; hidden ones are left out. Empty means where the studio was started.

    Raises:
        FormatError: where it is no folder that can be read.
    """
    path = Path(os.path.expanduser(folder) if folder else ".").absolute()
    folders: list[str] = []
    files: list[FolderFile] = []
    try:
        with os.scandir(path) as entries:
            for entry in entries:
                if entry.name.startswith(".") or len(folders) + len(files) >= MOST_ENTRIES:
                    continue
                try:
                    if entry.is_dir():
                        folders.append(entry.name)
                    elif entry.name.lower().endswith(SUFFIX):
                        found = entry.stat()
                        files.append(FolderFile(entry.name, found.st_size, found.st_mtime))
                except OSError:
                    continue  # a link that leads nowhere
    except (OSError, ValueError) as error:
        raise FormatError(f"cannot be shown: {getattr(error, 'strerror', None) or error}", path=path) from None
    return ProjectFolder(
        "project_folder",
        str(path),
        str(path.parent) if path.parent != path else "",
        sorted(folders, key=str.casefold),
        sorted(files, key=lambda file: file.name.casefold()),
    )
