"""Events in C3D files: the EVENT group, or the header's 18, to plain records and back.

Source: The C3D File Format, A Technical User Guide (Motion Lab Systems, 2021), chapters "Event Parameters" and "The
Header Section".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from keypose.io.c3d_data import Header
from keypose.io.c3d_parameters import Groups, Parameter, chars, ints, number, numbers, reals, strings


def read_events(groups: Groups, header: Header, first: int, rate_hz: float) -> tuple[dict[str, Any], ...]:
    """Events in time order: ``name``, ``time_s`` from the scene's start, ``context`` ("Left") and ``subject``.

    A file counts seconds from its frame 1, a scene from its own first frame.
    """
    offset = (first - 1) / rate_hz
    times = numbers(groups, "EVENT", "TIMES")
    count = int(number(groups, "EVENT", "USED") or 0)
    found: list[dict[str, Any]] = []
    if times is not None and count > 0:
        minutes_seconds = times[: len(times) // 2 * 2].reshape(-1, 2)[:count]
        columns = [strings(groups, "EVENT", name) for name in ("LABELS", "CONTEXTS", "SUBJECTS")]
        for i, (minutes, seconds) in enumerate(minutes_seconds.tolist()):
            name, context, subject = (column[i] if i < len(column) else "" for column in columns)
            time_s = 60 * minutes + seconds - offset
            if np.isfinite(time_s):
                found.append({"name": name, "time_s": time_s, "context": context, "subject": subject})
    else:
        found = [
            {"name": event.label, "time_s": event.time_s - offset, "context": "", "subject": ""}
            for event in header.events
        ]
    return tuple(sorted(found, key=lambda event: event["time_s"]))


def event_parameters(events: Sequence[Mapping[str, Any]], first: int, rate_hz: float) -> dict[str, Parameter]:
    """The EVENT group's parameters; minutes stay 0, as most writers have it."""
    offset = (first - 1) / rate_hz
    times = [[0.0, float(event.get("time_s", 0.0)) + offset] for event in events]
    return {
        "USED": ints([len(events)], ()),
        "CONTEXTS": chars([str(event.get("context", "")) for event in events]),
        "LABELS": chars([str(event.get("name", "")) for event in events]),
        "TIMES": reals(times, (2, len(events))),
        "SUBJECTS": chars([str(event.get("subject", "")) for event in events]),
    }
