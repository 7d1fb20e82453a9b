"""What a point of the surface sees inside the body: through voxels, and exactly past the triangles of its own shell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from keypose.arrays import Floats, Ints
from keypose.deform.weights_solid import Solid
from keypose.deform.weights_surface import Surface


@dataclass(frozen=True, slots=True)
class Sight:
    """A solid, and the triangles of its closed shells by voxel.

    Points of open shells see through voxels alone: gaps thinner than one are not seen.

    Shapes: ``starts`` (voxels + 1,) rows of ``listed``, triangles of ``surface``.
    """

    surface: Surface
    solid: Solid
    starts: Ints
    listed: Ints

    def sees(self, points: Ints, goals: Floats) -> Any:
        """Whether points (N,) of the surface see places (N, 3): all the way is in the body, and leaves their shell nowhere."""
        from keypose.kernels.sight import look

        out = np.zeros(len(points), bool)
        surface, solid = self.surface, self.solid
        look(
            np.asarray(points, np.int64),
            np.ascontiguousarray(goals),
            surface.points,
            surface.triangles,
            surface.shell_of,
            self.starts,
            self.listed,
            solid.filled,
            solid.origin_m,
            solid.voxel_m,
            out,
        )
        return out


def sight_of(surface: Surface, solid: Solid) -> Sight:
    """Everything that `Sight.sees` needs."""
    from keypose.kernels.sight import list_by_voxel

    wanted = surface.closed[surface.shell_of[surface.triangles[:, 0]]]
    shape = np.array(solid.filled.shape, np.int64)
    starts, listed = list_by_voxel(surface.points, surface.triangles, wanted, solid.origin_m, solid.voxel_m, shape)
    return Sight(surface, solid, starts, listed)
