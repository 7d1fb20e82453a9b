"""Projects: documents that commands change, with unlimited undo, saved in one file and kept safe by a journal."""
