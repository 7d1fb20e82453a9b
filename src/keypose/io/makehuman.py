"""MakeHuman: a whole character from its skeleton, base mesh, weights, targets and face poses, which lie side by side.

The file to open is the skeleton (.mhskel). Lengths are decimetres. The axes of the joints are those of MakeHuman's BVH
files (Z up, so the root of the rest pose is turned), so that their rotations apply joint by joint.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Literal

import numpy as np

from keypose.arrays import Array, Floats, Ints
from keypose.errors import FormatError, ShapeError, UnknownName
from keypose.io.axes import UNITS_M, y_up_rotation
from keypose.io.makehuman_files import Rig, read_pose_names, read_rig, read_target, read_weights
from keypose.io.normals import smooth_normals
from keypose.io.notes import Notes, UniqueNames
from keypose.io.obj_materials import beside
from keypose.io.obj_pieces import Piece, picked, piece, sparse_targets
from keypose.io.obj_polygons import triangulate
from keypose.io.obj_text import ObjText, read_text
from keypose.io.text import shown
from keypose.math import quat
from keypose.model import Character, Event, Material, Mesh, Motion, Part, Pose, Scene, Skeleton, Skin

_DM = UNITS_M["dm"]
_HELPERS = ("helper-", "joint-")
_KEPT = {
    "eyes": ("helper-l-eye", "helper-r-eye"),
    "eyelashes": ("helper-l-eyelashes-1", "helper-l-eyelashes-2", "helper-r-eyelashes-1", "helper-r-eyelashes-2"),
    "teeth": ("helper-upper-teeth", "helper-lower-teeth"),
    "tongue": ("helper-tongue",),
}
_OWN_FOLDERS = ("../3dobjs/base.obj", "../poseunits/face-poseunits.json")
_FINGERS = {1: "thumb", 2: "index", 3: "middle", 4: "ring", 5: "little"}
_SIDED = {
    "clavicle": "shoulder", "upperarm01": "upper_arm", "lowerarm01": "lower_arm", "wrist": "hand",
    "upperleg01": "upper_leg", "lowerleg01": "lower_leg", "foot": "foot", "toe2-1": "toes", "eye": "eye",
}  # fmt: skip
_MIDDLE = {
    "root": "hips", "spine05": "spine", "spine03": "chest", "spine01": "upper_chest", "neck01": "neck",
    "head": "head", "jaw": "jaw",
}  # fmt: skip
Files = str | PathLike[str] | Sequence[str | PathLike[str]]
PoseUnits = Literal["animation", "morphs", "both", "none"]


def read(
    path: Path,
    *,
    base: str | PathLike[str] | None = None,
    weights: str | PathLike[str] | None = None,
    targets: Files | None = None,
    poses: str | PathLike[str] | None = None,
    pose_units: PoseUnits = "animation",
    keep: Sequence[str] = ("eyes", "teeth", "tongue"),
    ground: bool = True,
    influences: int = 8,
) -> Scene:
    """Read a MakeHuman skeleton with its body as one character.

    Joints are at the mean of their vertices; helper geometry is dropped except what ``keep`` names ("eyes",
    "eyelashes", "teeth", "tongue"). Each target becomes a morph channel named after its file. Pose units become an
    animation of one frame each with their names as events, morph channels, both or nothing.

    Shapes and units: files that are not given are looked for beside the skeleton and in MakeHuman's own folders
    (``../3dobjs/base.obj``, ``../poseunits/face-poseunits.json``); ``targets`` are files or folders, by default
    ``targets`` beside the skeleton. ``ground`` puts the soles on the ground. At most ``influences`` joints hold a vertex.

    Raises:
        FormatError: where a file is missing or malformed, with file and place.
        UnknownName: for an option's value that does not exist.
    """
    for value, known in ((pose_units, ("animation", "morphs", "both", "none")), *((part, _KEPT) for part in keep)):
        if value not in known:
            raise UnknownName("choice", str(value), tuple(known))
    if not 1 <= influences <= 64:
        raise ShapeError(f"influences: expected 1 to 64, got {influences}")
    notes = Notes()
    mesh_file = _named(path, base, ("base.obj", _OWN_FOLDERS[0]), "base mesh", "base")
    text = read_text_of(mesh_file, notes)
    rig = read_rig(path, len(text.positions))
    names = [rig.weights_file] if rig.weights_file else []
    weights_file = _named(path, weights, (*names, f"{path.stem}_weights.mhw", f"{path.stem}.mhw"), "weights", "weights")
    if weights is None and names and weights_file.name != names[0]:
        notes.add(f"the skeleton names the weights {shown(names[0])}; {weights_file.name} was read")
    return _Reader(path, text, rig, notes).scene(
        weights_file,
        _target_files(path, targets),
        _pose_file(path, poses, notes) if pose_units != "none" else None,
        pose_units,
        tuple(keep),
        ground,
        influences,
    )


def read_text_of(path: Path, notes: Notes) -> ObjText:
    """An OBJ file's arrays; every error names the file."""
    try:
        text = read_text(path, notes)
    except FormatError as error:
        raise error.at(path) from None
    if not len(text.positions) or not len(text.sizes):
        raise FormatError("no mesh", path=path)
    return text


def _named(skeleton: Path, given: str | PathLike[str] | None, names: Sequence[str], what: str, option: str) -> Path:
    if given is not None:
        if not Path(given).is_file():
            raise FormatError(f"no such file; it was named as the {what}", path=given)
        return Path(given)
    for name in names:
        # MakeHuman's own folders are known by name; what a file names has to lie beside it
        path = skeleton.parent / name if name in _OWN_FOLDERS else beside(skeleton, name)
        if path is not None and path.is_file():
            return path
    listed = ", ".join(names[:3])
    raise FormatError(f"no {what} beside the skeleton ({listed}); name it with the option {option}")


def _target_files(skeleton: Path, given: Files | None) -> list[Path]:
    if given is None:
        folder = skeleton.parent / "targets"
        return sorted(folder.rglob("*.target")) if folder.is_dir() else []
    found: list[Path] = []
    for item in [given] if isinstance(given, (str, PathLike)) else given:
        path = Path(item)
        if path.is_dir():
            found += sorted(path.rglob("*.target"))
        elif path.is_file():
            found.append(path)
        else:
            raise FormatError("no such file; it was named as a target", path=path)
    return found


def _pose_file(skeleton: Path, given: str | PathLike[str] | None, notes: Notes) -> tuple[list[str], Path] | None:
    names = ("face-poseunits.json", _OWN_FOLDERS[1])
    if given is None and not any((skeleton.parent / name).is_file() for name in names):
        return None
    path = _named(skeleton, given, names, "file of pose units", "poses")
    frames, animation = read_pose_names(path)
    for name in (animation, f"{path.stem}.bvh"):
        file = beside(path, name) if name else None
        if file is not None and file.is_file():
            if name != animation:
                notes.add(f"{path.name} names the animation {animation or 'nothing'}; {name} was read")
            return frames, file
    raise FormatError(f"its animation {animation or path.stem + '.bvh'} is not beside it", path=path)


@dataclass(frozen=True, slots=True)
class _Channel:
    """A morph over the base mesh: moved vertices and their deltas in metres, Y up."""

    name: str
    vertices: Ints
    deltas: Floats


class _Reader:
    """Puts the files together."""

    def __init__(self, path: Path, text: ObjText, rig: Rig, notes: Notes) -> None:
        self.path, self.text, self.rig, self.notes = path, text, rig, notes
        self.positions = text.positions * _DM
        corners = text.corners[:, 0]
        triangles, faces = triangulate(text.positions, corners, text.sizes)
        self.triangles = triangles
        self.groups = [(group.group or group.object) for group in text.groups]
        self.group_of = text.face_groups[faces]
        self.body = [i for i, name in enumerate(self.groups) if not name.startswith(_HELPERS)]

    def scene(
        self,
        weights_file: Path,
        target_files: Sequence[Path],
        pose_file: tuple[list[str], Path] | None,
        pose_units: PoseUnits,
        keep: tuple[str, ...],
        ground: bool,
        influences: int,
    ) -> Scene:
        heads = np.array([self.positions[v].mean(axis=0) for v in self.rig.heads])
        tails = np.array([self.positions[v].mean(axis=0) for v in self.rig.tails])
        if ground:
            lowest = float(self.positions[self.text.corners[self.triangles_of(self.body), 0]][..., 1].min(initial=0.0))
            lift = np.array([0.0, -lowest, 0.0])
            self.positions, heads, tails = self.positions + lift, heads + lift, tails + lift
            self.notes.add(f"raised by {-lowest:.3f} m to stand on the ground (ground)")
        skeleton = self.skeleton(heads, tails)
        skin = self.skin(weights_file, heads, influences)
        channels = self.channels(target_files)
        motion = None
        if pose_file is not None:
            motion = self.motion(skeleton, *pose_file)
        if motion is not None and pose_units in ("morphs", "both"):
            channels += self.baked(skeleton, skin, motion, {c.name for c in channels})
        parts = self.parts(skin, channels, keep)
        roles = {role: i for i, name in enumerate(skeleton.names) if (role := role_of(name))}
        character = Character(
            skeleton, tuple(parts), self.rig.name or self.path.stem, tuple(c.name for c in channels), roles=roles
        )
        animations = (motion,) if motion is not None and pose_units in ("animation", "both") else ()
        return Scene((character,), animations, "makehuman", _DM, "Y", self.notes.texts())

    def triangles_of(self, groups: Sequence[int]) -> Ints:
        return self.triangles[np.isin(self.group_of, groups)]

    def skeleton(self, heads: Floats, tails: Floats) -> Skeleton:
        parents = self.rig.parents
        turn = y_up_rotation("Z")
        back = quat.conjugate(turn)
        inner = parents >= 0
        offsets = heads.copy()
        offsets[inner] = np.asarray(quat.rotate(back, heads[inner] - heads[parents[inner]]))
        rotations = np.where(inner[:, None], (1.0, 0.0, 0.0, 0.0), turn)
        leaves = np.setdiff1d(np.arange(len(parents)), parents)
        ends = np.asarray(quat.rotate(back, tails - heads))
        tips = tuple((int(j), (float(ends[j, 0]), float(ends[j, 1]), float(ends[j, 2]))) for j in leaves)
        return Skeleton(self.rig.names, parents, Pose(offsets, rotations, np.ones_like(offsets)), tips)

    def skin(self, weights_file: Path, heads: Floats, influences: int) -> Skin:
        """Over all vertices of the base mesh."""
        count = len(self.positions)
        bones, vertices, weights, strangers = read_weights(weights_file, self.rig.names, count)
        if strangers:
            self.notes.add(f"weights of {len(strangers)} bones that the skeleton has not were dropped")
        order = np.lexsort((-weights, vertices))
        bones, vertices, weights = bones[order], vertices[order], weights[order]
        rank = np.arange(len(vertices)) - np.searchsorted(vertices, vertices)
        cut = rank >= influences
        if cut.any():
            self.notes.add(
                f"{len(np.unique(vertices[cut]))} vertices had more than {influences} joints; the rest was dropped"
            )
        bones, vertices, weights, rank = bones[~cut], vertices[~cut], weights[~cut], rank[~cut]
        width = int(rank.max(initial=0)) + 1
        joints = np.zeros((count, width), np.int32)
        table = np.zeros((count, width))
        joints[vertices, rank] = bones
        table[vertices, rank] = weights
        total = table.sum(axis=1)
        free = total <= 0
        table[free, 0] = 1.0  # held by the first bone, the root
        table /= np.where(free, 1.0, total)[:, None]
        used = np.unique(self.text.corners[self.triangles_of(self.body), 0])
        if free[used].any():
            self.notes.add(
                f"{int(free[used].sum())} vertices of the body have no weight; '{self.rig.names[0]}' holds them"
            )
        back = np.asarray(quat.to_matrix(quat.conjugate(y_up_rotation("Z"))))
        bind = np.tile(np.eye(4), (len(heads), 1, 1))
        bind[:, :3, :3] = back
        bind[:, :3, 3] = -heads @ back.T
        return Skin(np.arange(len(heads)), bind, joints, table)

    def channels(self, files: Sequence[Path]) -> list[_Channel]:
        names = UniqueNames()
        found: list[_Channel] = []
        for file in files:
            try:
                vertices, deltas = read_target(file, len(self.positions))
            except FormatError as error:
                raise error.at(error.path or file) from None
            found.append(_Channel(names.add(file.stem), vertices, deltas * _DM))
        return found

    def motion(self, skeleton: Skeleton, names: list[str], file: Path) -> Motion | None:
        """The pose units on this skeleton, one frame each."""
        from keypose.io import bvh

        try:
            scene = bvh.read(file, unit="dm", up="Z")
        except FormatError as error:
            raise error.at(error.path or file) from None
        units = next((a for a in scene.animations if isinstance(a, Motion)), None)
        if units is None:
            self.notes.add(f"{file.name} has no frames")
            return None
        if units.frame_count != len(names):
            self.notes.add(f"{file.name} has {units.frame_count} frames for {len(names)} names")
        place = {name: j for j, name in enumerate(units.joint_names)}
        missing = [name for name in skeleton.names if name not in place]
        if missing:
            self.notes.add(f"{file.name}: {len(missing)} joints are not in it and stay at rest")
        rotations = np.tile(skeleton.rest.rotations, (units.frame_count, 1, 1))
        translations = np.tile(skeleton.rest.translations, (units.frame_count, 1, 1))
        source = units.pose.broadcast()
        theirs = scene.character.skeleton
        for joint, name in enumerate(skeleton.names):
            if name in place:
                rotations[:, joint] = source.rotations[:, place[name]]
                # the body's own proportions stay: a joint moves by what it moves in the file
                rest = theirs.rest.translations[place[name]]
                translations[:, joint] += source.translations[:, place[name]] - rest
        pose = Pose(translations, rotations, skeleton.rest.scales)
        named = names[: units.frame_count]
        events = tuple(Event(k / units.rate_hz, name) for k, name in enumerate(named))
        return Motion(skeleton.names, pose, units.rate_hz, file.stem, events=events)

    def baked(self, skeleton: Skeleton, skin: Skin, motion: Motion, taken: set[str]) -> list[_Channel]:
        """What each pose unit does to the mesh, as a morph: exact alone, a sum of straight paths together."""
        from keypose.deform import skin_matrices, skin_points
        from keypose.evaluate import world

        names = UniqueNames()
        for name in taken:
            names.add(name)
        found: list[_Channel] = []
        for frame, event in enumerate(motion.events):
            model_from_joint: Array = world(skeleton, motion.pose[frame])
            moved, _ = skin_points(self.positions, None, skin, skin_matrices(skin, model_from_joint), "linear")
            deltas = np.asarray(moved) - self.positions
            hit = np.nonzero(np.abs(deltas).max(axis=1) > 1e-6)[0]
            if len(hit):
                found.append(_Channel(names.add(event.name), hit, deltas[hit]))
        return found

    def parts(self, skin: Skin, channels: list[_Channel], keep: tuple[str, ...]) -> list[Part]:
        wanted: list[tuple[str, list[int]]] = [("body", self.body)]
        wanted += [(name, [i for i, group in enumerate(self.groups) if group in _KEPT[name]]) for name in keep]
        found: list[Part] = []
        for number, (name, groups) in enumerate(wanted):
            mine = self.triangles_of(groups)
            if not len(mine):
                self.notes.add(f"the base mesh has no {name}")
                continue
            found.append(self.part(name, number, piece(self.text.corners, mine), mine, skin, channels))
        dropped = len(self.groups) - sum(len(groups) for _, groups in wanted)
        if dropped:
            kept = f"; kept as parts: {', '.join(keep)} (keep)" if keep else ""
            self.notes.add(f"{dropped} groups of helper geometry were dropped{kept}")
        return found

    def part(self, name: str, group: int, found: Piece, triangles: Ints, skin: Skin, channels: list[_Channel]) -> Part:
        corners = self.text.corners[triangles, 0]
        smooth = smooth_normals(self.positions, corners)
        turns: list[Floats] = []
        used = np.zeros(len(self.positions), bool)
        used[found.positions] = True
        mine = [c for c in channels if used[c.vertices].any()]
        for channel in mine:
            moved = self.positions.copy()
            moved[channel.vertices] += channel.deltas
            turns.append(smooth_normals(moved, corners) - smooth)
        morphs = None
        if mine:
            moves = [(c.vertices, c.deltas) for c in mine]
            morphs = sparse_targets([c.name for c in mine], moves, found.positions, turns)
        uvs = picked(self.text.uvs, found.uvs)
        mesh = Mesh(
            self.positions[found.positions].astype(np.float32),
            found.triangles,
            smooth[found.positions].astype(np.float32),
            None if uvs is None else np.stack([uvs[:, 0], 1.0 - uvs[:, 1]], axis=1).astype(np.float32),
        )
        bound = Skin(
            skin.palette,
            skin.joint_from_mesh.astype(np.float32),
            skin.joints[found.positions],
            skin.weights[found.positions].astype(np.float32),
        )
        place = {c.name: i for i, c in enumerate(channels)}
        driven = None if morphs is None else np.array([place[n] for n in morphs.names], np.int32)
        return Part(name, mesh, Material(name=name), bound, morphs=morphs, morph_channels=driven, group=group)


def role_of(bone: str) -> str:
    """The humanoid role of a bone of MakeHuman's default skeleton, or ""."""
    stem, _, side = bone.partition(".")
    if not side:
        return _MIDDLE.get(stem, "")
    which = {"L": "left", "R": "right"}.get(side, "")
    if which and stem in _SIDED:
        return f"{which}_{_SIDED[stem]}"
    finger, _, joint = stem.removeprefix("finger").partition("-")
    if (
        which
        and stem.startswith("finger")
        and finger.isdigit()
        and int(finger) in _FINGERS
        and joint in ("1", "2", "3")
    ):
        segments = ("metacarpal", "proximal", "distal") if finger == "1" else ("proximal", "intermediate", "distal")
        return f"{which}_{_FINGERS[int(finger)]}_{segments[int(joint) - 1]}"
    return ""
