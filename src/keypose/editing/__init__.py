"""Editing of keys and motion: pure functions from curves and clips to curves and clips."""
