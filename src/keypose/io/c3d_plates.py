"""Force plates in C3D's parameters: FORCE_PLATFORM to `ForcePlate` and back.

Source: The C3D File Format, A Technical User Guide (Motion Lab Systems, 2021), chapter "Force Plate Parameters".
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from keypose.arrays import Array
from keypose.io.axes import Turn, turn_in, turn_out
from keypose.io.c3d_parameters import Groups, Parameter, find, ints, number, numbers, reals
from keypose.model import ForcePlate

_GROUP = "FORCE_PLATFORM"
_MOST_PLATES = 255


def read_plates(
    groups: Groups, turn: Turn, unit_m: float, channels: Sequence[str], notes: list[str]
) -> tuple[ForcePlate, ...]:
    """The plates; one without corners is left out with a note.

    CORNERS are places in the lab; ORIGIN is in the plate's own axes and only changes its unit.
    """
    count = min(int(number(groups, _GROUP, "USED") or 0), _MOST_PLATES)
    corners, origins = numbers(groups, _GROUP, "CORNERS"), numbers(groups, _GROUP, "ORIGIN")
    kinds, wires = numbers(groups, _GROUP, "TYPE"), find(groups, _GROUP, "CHANNEL")
    plates: list[ForcePlate] = []
    for i in range(count):
        own = corners[12 * i : 12 * i + 12] if corners is not None else np.zeros(0)
        if len(own) < 12 or not np.isfinite(own).all():
            notes.append(f"force plate {i + 1} has no corners; it was left out")
            continue
        origin = origins[3 * i : 3 * i + 3] if origins is not None else np.zeros(0)
        known = len(origin) == 3 and np.isfinite(origin).all()
        kind = kinds[i] if kinds is not None and i < len(kinds) and np.isfinite(kinds[i]) else 0
        plates.append(
            ForcePlate(
                turn_in(own.reshape(4, 3), turn, unit_m),
                origin * unit_m if known else np.zeros(3),
                int(kind),
                _channels(wires, i, channels),
                _calibration(find(groups, _GROUP, "CAL_MATRIX"), i),
            )
        )
    return tuple(plates)


def _channels(wires: Parameter | None, plate: int, names: Sequence[str]) -> tuple[str, ...]:
    """Names of the channels of a plate; an empty name where it has none."""
    if wires is None or wires.kind == "char" or not wires.dims:
        return ()
    width = wires.dims[0]
    own = wires.values[width * plate : width * (plate + 1)].astype(np.float64)
    own = np.where(np.isfinite(own), own, 0.0)
    found = [names[int(c) - 1] if 1 <= c <= len(names) else "" for c in own]
    while found and not found[-1]:
        found.pop()
    return tuple(found)


def _calibration(matrix: Parameter | None, plate: int) -> Array | None:
    if matrix is None or matrix.kind != "float" or len(matrix.dims) < 2:
        return None
    rows, columns = matrix.dims[:2]
    own = matrix.values[rows * columns * plate : rows * columns * (plate + 1)]
    if not len(own) or len(own) < rows * columns:
        return None
    # the first index runs fastest
    return own.reshape(columns, rows).T.astype(np.float64)


def plate_parameters(
    plates: Sequence[ForcePlate], turn: Turn, unit_m: float, channels: Sequence[str], notes: list[str]
) -> dict[str, Parameter]:
    """The parameters of FORCE_PLATFORM that describe the plates."""
    count = len(plates)
    made = {
        "USED": ints([count], ()),
        "TYPE": ints([p.kind for p in plates]),
        "CORNERS": reals([turn_out(p.corners, turn, unit_m) for p in plates], (3, 4, count)),
        "ORIGIN": reals([np.asarray(p.origin) / unit_m for p in plates], (3, count)),
    }
    width = max([6, *(len(p.channels) for p in plates)])
    place = {name: i + 1 for i, name in enumerate(channels)}
    lost = sorted({name for p in plates for name in p.channels if name and name not in place})
    if lost:
        notes.append(f"force plates refer to analog channels that are not in the scene: {', '.join(lost[:5])}")
    wires = [[place.get(name, 0) for name in p.channels] + [0] * (width - len(p.channels)) for p in plates]
    made["CHANNEL"] = ints(np.array(wires, np.int64).reshape(-1).tolist(), (width, count))
    matrices = [p.calibration for p in plates]
    shape = next((m.shape for m in matrices if m is not None), None)
    if shape is not None:
        # a plate without its own matrix, or one of another shape, gets none: zeros
        same = [np.zeros(shape) if m is None or m.shape != shape else np.asarray(m) for m in matrices]
        if any(m is not None and m.shape != shape for m in matrices):
            notes.append("force plates have calibration matrices of several shapes; C3D holds one shape")
        made["CAL_MATRIX"] = reals([m.T for m in same], (*shape, count))
    return made
