"""The software backend: the same picture as OpenGL draws, without a driver.

Skins with `keypose.deform`, then works through bands of rows in several threads: samples that know the nearest
triangle, light for each triangle once per pixel, the colours of the samples laid over the backdrop.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from keypose import deform
from keypose.arrays import Floats, Ints
from keypose.render import raster, shade
from keypose.render.camera import SHADOW_SIZE, View
from keypose.render.frame import CLIP_FROM_WORLD, LIGHT_FROM_WORLD, WORLD_FROM_LIGHT, pack_frame
from keypose.render.settings import Picture, RenderSettings
from keypose.render.stage import Moment, Stage
from keypose.render.surfaces import Surface, surfaces

_ROWS = 16  # of the picture in one band
_MASK_SIZE, _CONTACT_SIZE = 256, 128
_GLASS = -1
_NOWHERE = np.array([0, -1, 0, -1])


class CpuRenderer:
    """Draws moments of one stage into pictures of one size."""

    name = "cpu"

    def __init__(self, stage: Stage, settings: RenderSettings, supersample: int) -> None:
        self.settings = settings
        self.offsets = raster.OFFSETS_4 if supersample == 1 else raster.OFFSETS_8
        self.surfaces = surfaces(stage)
        self._gather()
        width, height = settings.width, settings.height
        self.still = np.zeros((height, width, 3), np.float32)
        self.still_key = b""
        self.still_bytes = np.zeros((height, width, 4), np.uint8)
        self.workers = max(1, min(os.cpu_count() or 1, 32, -(-height // _ROWS)))
        self.pool = ThreadPoolExecutor(self.workers) if self.workers > 1 else None
        rows, samples = _ROWS, len(self.offsets)
        self.room = [
            (
                np.ones((rows, width, samples), np.float32),
                np.full((rows, width, samples), -1, np.int32),
                np.empty((rows, width, 4), np.float32),
            )
            for _ in range(self.workers)
        ]
        self.sun_depth = np.ones((SHADOW_SIZE, SHADOW_SIZE), np.float32)
        self.crisp = np.zeros((_MASK_SIZE, _MASK_SIZE, 2), np.float32)
        self.soft = np.zeros((_MASK_SIZE // 2, _MASK_SIZE // 2, 2), np.float32)
        self.contact = np.zeros((_CONTACT_SIZE, _CONTACT_SIZE, 1), np.float32)

    def draw(self, moment: Moment, view: View) -> Picture:
        """One picture, (H, W, 4) uint8, straight alpha."""
        settings = self.settings
        width, height = settings.width, settings.height
        frame = pack_frame(view, settings, width, height).astype(np.float64)
        has_floor = settings.ground and view.above
        self._pose(moment)
        if settings.shadows:
            self._shadows(frame, view)
        floor_from_pixel, floor_depth = _floor(view, width, height)
        if not settings.transparent:
            self._backdrop(frame, view, floor_from_pixel)
        clip = _projected(self.world, frame[CLIP_FROM_WORLD : CLIP_FROM_WORLD + 4])
        over = self.overlays[self.vertex_owner]
        clip[over, 2] = 0.005 * clip[over, 2] - 0.995 * clip[over, 3]
        setups = np.empty((len(self.triangles), raster.COLUMNS))
        raster.set_up(clip, self.triangles, width, height, setups)
        bands = -(-height // _ROWS)
        starts, members = raster.bin_triangles(setups, _ROWS, bands)
        glass = self._glass(view)
        out = self.still_bytes.copy()
        shadow_box = self._shadow_box(floor_from_pixel, view) if settings.shadows and has_floor else _NOWHERE
        reach = float(np.abs(self.offsets).max())

        def band(index: int, room: tuple[Any, Any, Any]) -> None:
            top = index * _ROWS
            shade.compose_band(
                frame, floor_from_pixel, floor_depth, has_floor, settings.transparent, setups,
                members[starts[index] : starts[index + 1]], self.owners, self.table, self.layers, self.ghost_count,
                glass, self.triangles, self.world, self.normals, self.uvs, self.colors, self.texels, self.levels,
                self.sun_depth, self.crisp, self.soft, self.contact, shadow_box, self.offsets, reach, self.still, top,
                min(top + _ROWS, height), *room, out,
            )  # fmt: skip

        self._spread(band, bands)
        return _straight(out) if settings.transparent else out

    def close(self) -> None:
        """End the threads."""
        if self.pool:
            self.pool.shutdown()

    def _gather(self) -> None:
        """All surfaces in common arrays."""
        count = sum(s.part.mesh.vertex_count for s in self.surfaces)
        self.world = np.zeros((count, 3))
        self.normals = np.zeros((count, 3), np.float32)
        self.uvs, self.colors = np.zeros((count, 2)), np.ones((count, 4), np.float32)
        self.table = np.zeros((len(self.surfaces), shade.SURFACE_COLUMNS))
        triangles: list[Ints] = []
        owners: list[Ints] = []
        layers: list[Ints] = []
        vertex_owner: list[Ints] = []
        self.firsts: list[int] = []
        mips = _Mips()
        ghosts: dict[int, int] = {}
        first = 0
        for index, surface in enumerate(self.surfaces):
            mesh = surface.part.mesh
            self.firsts.append(first)
            rows = slice(first, first + mesh.vertex_count)
            if mesh.uvs is not None:
                self.uvs[rows] = np.nan_to_num(np.clip(mesh.uvs, -1e6, 1e6))
            if mesh.colors is not None:
                self.colors[rows] = mesh.colors
            triangles.append(np.asarray(mesh.triangles) + first)
            owners.append(np.full(len(mesh.triangles), index, np.int32))
            vertex_owner.append(np.full(mesh.vertex_count, index, np.int32))
            if surface.cast.ghost > 0:
                layer = ghosts.setdefault(surface.drawn, len(ghosts) + 1)
            else:
                layer = _GLASS if surface.blended else 0
            layers.append(np.full(len(mesh.triangles), layer, np.int32))
            self.table[index] = self._row(surface, mips)
            first += mesh.vertex_count
        self.triangles = np.concatenate(triangles).astype(np.int32)
        self.owners, self.layers = np.concatenate(owners), np.concatenate(layers)
        self.vertex_owner = np.concatenate(vertex_owner)
        self.overlays = self.table[:, shade.OVERLAY] > 0
        self.ghost_count = len(ghosts)
        shadowless = np.array([not s.casts_shadow for s in self.surfaces])
        self.shadowless = shadowless[self.owners].astype(np.float32)
        self.texels, self.levels = mips.arrays()

    def _row(self, surface: Surface, mips: _Mips) -> Floats:
        material, cast = surface.material, surface.cast
        row = np.zeros(shade.SURFACE_COLUMNS)
        alpha = 1.0 if material.alpha_mode == "OPAQUE" else material.base_color[3]
        row[shade.BASE : shade.BASE + 4] = (*material.base_color[:3], alpha)
        row[shade.EMISSIVE : shade.EMISSIVE + 3] = material.emissive
        row[shade.METALLIC], row[shade.ROUGHNESS] = material.metallic, material.roughness
        row[shade.CUTOFF] = {"MASK": material.alpha_cutoff, "BLEND": -1.0}.get(material.alpha_mode, 0.0)
        row[shade.OPACITY] = cast.ghost if cast.ghost > 0 else 1.0
        row[shade.UNLIT], row[shade.FLAT] = material.unlit, surface.part.mesh.normals is None
        row[shade.OVERLAY], row[shade.GHOST] = cast.overlay, cast.ghost > 0
        row[shade.FIRST_LEVEL], row[shade.LEVELS] = mips.add(surface.texture)
        theme = self.settings.colors
        row[shade.TINT : shade.TINT + 3] = theme.bone_left if cast.delay_s > 0 else theme.bone_right
        row[shade.STRENGTH], row[shade.WINDING] = 0.6, 1.0
        row[shade.CULLED] = not (material.double_sided or cast.ghost > 0)
        return row

    def _pose(self, moment: Moment) -> None:
        """World positions and normals of all surfaces."""
        for index, surface in enumerate(self.surfaces):
            mesh, first = surface.part.mesh, self.firsts[index]
            rows = slice(first, first + mesh.vertex_count)
            deformed = deform.deform_part(
                surface.character,
                surface.part,
                moment.matrices[surface.drawn],
                moment.morph_weights[surface.drawn],
                with_normals=mesh.normals is not None,
            )
            if mesh.normals is None:
                self.world[rows] = deformed
            else:
                self.world[rows], self.normals[rows] = deformed
            self.table[index, shade.WINDING] = -1.0 if surface.mirrored(moment) else 1.0

    def _shadows(self, frame: Floats, view: View) -> None:
        clip = _projected(self.world, frame[LIGHT_FROM_WORLD : LIGHT_FROM_WORLD + 4])
        self._depth_map(clip, self.sun_depth)
        if not self.settings.ground:
            return
        world_from_light = np.ascontiguousarray(frame[WORLD_FROM_LIGHT : WORLD_FROM_LIGHT + 4].T)
        block = SHADOW_SIZE // _MASK_SIZE

        def cover(index: int, _room: object) -> None:
            raster.cover_floor(
                self.sun_depth, world_from_light, view.floor, float(view.key[1]), view.radius, block,
                index * _ROWS, (index + 1) * _ROWS, self.crisp,
            )  # fmt: skip

        self._spread(cover, _MASK_SIZE // _ROWS)
        raster.halve(self.crisp, self.soft)
        raster.blur(self.soft, _gaussian(8, 3.4), self.soft)
        below = np.ones((len(self.world), 4))
        below[:, 0] = (self.world[:, 0] - view.center[0]) / (1.15 * view.radius)
        below[:, 1] = (self.world[:, 2] - view.center[2]) / (1.15 * view.radius)
        below[:, 2] = (self.world[:, 1] - view.floor) / (0.22 * view.radius) * 2 - 1
        depth = np.empty((_CONTACT_SIZE, _CONTACT_SIZE), np.float32)
        self._depth_map(below, depth)
        raster.near_floor(depth, self.contact)
        raster.blur(self.contact, _gaussian(7, 3.0), self.contact)

    def _depth_map(self, clip: Floats, depth: Floats) -> None:
        size = len(depth)
        setups = np.empty((len(self.triangles), raster.COLUMNS))
        raster.set_up(clip, self.triangles, size, size, setups)
        rows = max(_ROWS, size // 32)
        bands = -(-size // rows)
        starts, members = raster.bin_triangles(setups, rows, bands)

        def band(index: int, _room: object) -> None:
            top, bottom = index * rows, min((index + 1) * rows, size)
            depth[top:bottom] = 1.0
            raster.draw_depth(setups, members[starts[index] : starts[index + 1]], self.shadowless, top, bottom, depth)

        self._spread(band, bands)

    def _backdrop(self, frame: Floats, view: View, floor_from_pixel: Floats) -> None:
        has_floor = self.settings.ground and view.above
        key = np.concatenate([view.clip_from_world.ravel(), view.focus]).tobytes()
        if key == self.still_key:
            return
        self.still_key = key
        width, height = self.settings.width, self.settings.height

        def band(index: int, _room: object) -> None:
            bottom = min((index + 1) * _ROWS, height)
            shade.draw_backdrop(
                frame, floor_from_pixel, has_floor, width, height, index * _ROWS, bottom, self.still, self.still_bytes
            )

        self._spread(band, -(-height // _ROWS))

    def _shadow_box(self, floor_from_pixel: Floats, view: View) -> Ints:
        """The pixels (left, right, top, bottom) in which the floor may be in shadow."""
        width, height = self.settings.width, self.settings.height
        shaded, near = _box(self.soft[..., 0]), _box(self.contact[..., 0])
        corners: list[Floats] = []
        world_from_light = np.linalg.inv(view.light_from_world)
        if shaded is not None:
            for x, y in itertools.product(shaded[0], shaded[1]):
                start = world_from_light @ np.array([2 * x - 1, 1 - 2 * y, -1, 1])
                corners.append(start[:3] - view.key * (start[1] - view.floor) / view.key[1])
        if near is not None:
            for x, y in itertools.product(near[0], near[1]):
                away = 1.15 * view.radius * np.array([2 * x - 1, 0, 1 - 2 * y])
                corners.append(view.center + away)
        if not corners or not floor_from_pixel.any():
            return _NOWHERE
        # a flat outline stays within the outline of its corners, unless some of them lie behind the eye
        pixels = [np.linalg.inv(floor_from_pixel) @ (corner[0], corner[2], 1.0) for corner in corners]
        if any(p[2] <= 0 for p in pixels):
            return np.array([0, width - 1, 0, height - 1])
        x, y = np.array([p[:2] / p[2] for p in pixels]).T
        low, high = np.floor([x.min(), y.min()]) - 1, np.ceil([x.max(), y.max()]) + 1
        limit = (width - 1, height - 1)
        (left, top), (right, bottom) = np.clip(low, 0, limit), np.clip(high, 0, limit)
        return np.array([left, right, top, bottom], np.int64)

    def _glass(self, view: View) -> Ints:
        """Triangles that others show through, from far to near."""
        chosen = np.nonzero(self.layers == _GLASS)[0]
        if not len(chosen):
            return np.zeros(0, np.int32)
        middles = self.world[self.triangles[chosen]].mean(axis=1)
        return chosen[np.argsort(-(middles @ view.forward), kind="stable")].astype(np.int32)

    def _spread(self, band: Callable[[int, Any], None], count: int) -> None:
        """Work through bands in all threads."""
        todo = itertools.count()

        def work(worker: int) -> None:
            while (index := next(todo)) < count:
                band(index, self.room[worker])

        if self.pool is None:
            work(0)
        else:
            list(self.pool.map(work, range(self.workers)))


class _Mips:
    """Textures with their smaller and smaller versions, in one array."""

    def __init__(self) -> None:
        self.texels: list[Picture] = []
        self.levels: list[tuple[int, int, int]] = []
        self.known: dict[int, tuple[int, int]] = {}
        self.size = 0

    def add(self, pixels: Picture | None) -> tuple[int, int]:
        """First level and number of levels of a texture (H, W, 4) uint8; -1 and 0 for none."""
        if pixels is None:
            return -1, 0
        if id(pixels) not in self.known:
            first = len(self.levels)
            linear = np.concatenate([shade.LINEAR[pixels[..., :3]], pixels[..., 3:] / np.float32(255)], axis=-1)
            while True:
                height, width = linear.shape[:2]
                colors = shade.ENCODED[np.rint(linear[..., :3] * shade.ENCODE_STEPS).astype(np.int32)]
                texel = np.rint(np.concatenate([colors, linear[..., 3:]], axis=-1) * 255).astype(np.uint8)
                self.texels.append(texel.reshape(-1, 4))
                self.levels.append((self.size, width, height))
                self.size += width * height
                if max(width, height) == 1:
                    break
                linear = _halved(_halved(linear, 0), 1)
            self.known[id(pixels)] = (first, len(self.levels) - first)
        return self.known[id(pixels)]

    def arrays(self) -> tuple[Picture, Ints]:
        """All texels (N, 4) uint8, and offset, width, height of every level."""
        if not self.levels:
            return np.zeros((1, 4), np.uint8), np.zeros((1, 3), np.int64)
        return np.concatenate(self.texels), np.array(self.levels, np.int64)


def _halved(pixels: Floats, axis: int) -> Floats:
    count = pixels.shape[axis]
    if count == 1:
        return pixels
    even = np.take(pixels, range(0, count - 1, 2), axis)
    return 0.5 * (even + np.take(pixels, range(1, count, 2)[: even.shape[axis]], axis))


def _projected(world: Floats, columns: Floats) -> Floats:
    """Clip coordinates (V, 4) of world positions; the matrix is given column by column."""
    return world @ columns[:3] + columns[3]


def _floor(view: View, width: int, height: int) -> tuple[Floats, Floats]:
    """The map from pixels to the floor's (x, z), and the floor's depth as a linear function of the pixel."""
    matrix = view.clip_from_world
    level = view.floor - 0.0015 * view.reach  # as in ground.vert
    pixel_from_clip = np.array([[0.5 * width, 0, 0.5 * width], [0, -0.5 * height, 0.5 * height], [0, 0, 1.0]])
    clip_from_floor = np.stack([matrix[:, 0], matrix[:, 2], matrix[:, 1] * level + matrix[:, 3]], axis=1)
    pixel_from_floor = pixel_from_clip @ clip_from_floor[[0, 1, 3]]
    if abs(np.linalg.det(pixel_from_floor)) < 1e-30:  # the eye lies in the floor: it is seen edge-on
        return np.zeros((3, 3)), np.zeros(3)
    floor_from_pixel = np.linalg.inv(pixel_from_floor)
    # of the inverse only the sign of the last row's product must be right: it is 1 / w, positive before the eye
    return floor_from_pixel, clip_from_floor[2] @ floor_from_pixel


def _box(plane: Floats) -> tuple[Floats, Floats] | None:
    """First and last place (0..1, one texel to spare) of what is not zero, across and down."""
    filled = plane > 1e-4
    if not filled.any():
        return None
    spans = [np.nonzero(filled.any(axis=axis))[0] for axis in (0, 1)]
    across, down = (np.array([s[0] - 1, s[-1] + 2]) / len(plane) for s in spans)
    return across, down


def _gaussian(taps: int, sigma: float) -> Floats:
    weights = np.exp(-0.5 * (np.arange(taps + 1) / sigma) ** 2)
    return weights / (weights[0] + 2 * weights[1:].sum())


def _straight(picture: Picture) -> Picture:
    alpha = picture[..., 3:].astype(np.float32)
    colors = picture[..., :3] * (255 / np.maximum(alpha, 1))
    return np.concatenate([np.clip(np.rint(colors), 0, 255), alpha], axis=-1).astype(np.uint8)
