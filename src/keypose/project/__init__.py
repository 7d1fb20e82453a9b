"""Projects: documents that commands change, with unlimited undo, saved in one file and kept safe by a journal.

The types are `keypose.model.Document` and `keypose.model.StoredPose`; commands are in `keypose.project.commands`.
"""

from keypose.project.commands import apply_all
from keypose.project.document import add_character, difference, import_animation
from keypose.project.file import load, save, state_folder
from keypose.project.history import History
from keypose.project.locks import Locked
from keypose.project.workspace import NotSaved, Unsaved, Workspace

__all__ = [
    "History",
    "Locked",
    "NotSaved",
    "Unsaved",
    "Workspace",
    "add_character",
    "apply_all",
    "difference",
    "import_animation",
    "load",
    "save",
    "state_folder",
]
