"""Writing USD: UsdSkel roots with skeletons, animations, skins, blend shapes and materials; layers and packages."""

from __future__ import annotations

import os
import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

import keypose
from keypose.deform import deform_part
from keypose.errors import FormatError, ShapeError
from keypose.evaluate import world
from keypose.io import atomic
from keypose.io.axes import unit_in_metres
from keypose.io.notes import Notes
from keypose.io.usd.library import Names, entitle, library, vectors
from keypose.io.usd.out_animations import AnimationWriter, Written, common_rate
from keypose.io.usd.out_materials import MaterialWriter
from keypose.io.usd.out_skeleton import SkeletonWriter
from keypose.io.usd.out_surfaces import SurfaceWriter
from keypose.model import Character, Scene

_LAYERS = (".usd", ".usda", ".usdc")
_MOMENT = 315_532_800  # 1980, where the clocks of zip archives begin: equal scenes make equal packages


def write(scene: Scene, path: Path, *, unit: str | float = "m", rate_hz: float | None = None) -> tuple[str, ...]:
    """Write a scene as a USD layer or package, Y up; returns notes of what was changed or could not be held.

    The suffix decides: ``.usda`` is text, ``.usdc`` and ``.usd`` are binary, with their pictures beside them; ``.usdz`` is
    a package with the pictures inside. The first animation is bound, further ones lie beside it.

    Shapes and units: ``unit`` is a name ("cm") or metres per file unit; ``rate_hz`` the time codes per second, if not given
    the highest rate of the animations, else 24.

    Raises:
        FormatError: where the suffix is another one or the file cannot be written.
        UnknownName, ShapeError: for a unit or rate that is none.
        MissingExtra: where usd-core is not installed.
    """
    suffix = path.suffix.lower()
    if suffix not in (*_LAYERS, ".usdz"):
        raise FormatError(f"expected a name ending in .usd, .usda, .usdc or .usdz, got '{path.suffix}'", path=path)
    if rate_hz is not None and not (np.isfinite(rate_hz) and rate_hz > 0):
        raise ShapeError(f"rate_hz: expected a positive number, got {rate_hz}")
    usd, notes, pictures = library(), Notes(), dict[str, bytes]()
    prefix = "textures/" if suffix == ".usdz" else f"{path.stem}_"
    stage = _Writer(usd, scene, unit_in_metres(unit), rate_hz, pictures, prefix, notes).stage()
    layer = stage.GetRootLayer()
    with ExitStack() as files:
        temporary = files.enter_context(atomic.replacing(path))
        if suffix == ".usdz":
            _package(usd, layer, pictures, path, temporary)
        else:
            for name, data in pictures.items():
                files.enter_context(atomic.replacing(path.with_name(name))).write_bytes(data)
            _export(layer, temporary, path)
    return notes.texts()


def _export(layer: Any, target: Path, path: Path) -> None:
    if not layer.Export(os.fspath(target)):
        raise FormatError("it cannot be written", path=path)


def _package(usd: Any, layer: Any, pictures: dict[str, bytes], path: Path, target: Path) -> None:
    """A package: the layer first, everything stored as it is."""
    with tempfile.TemporaryDirectory() as folder:
        contents = {f"{_stem(path)}.usdc": Path(folder, "root.usdc")}
        _export(layer, contents[f"{_stem(path)}.usdc"], path)
        for number, (name, data) in enumerate(pictures.items()):
            contents[name] = Path(folder, f"{number}")
            contents[name].write_bytes(data)
        archives = usd.Sdf if hasattr(usd.Sdf, "ZipFileWriter") else usd.Usd  # it has moved
        writer = archives.ZipFileWriter.CreateNew(os.fspath(target))
        for name, file in contents.items():
            os.utime(file, (_MOMENT, _MOMENT))
            writer.AddFile(os.fspath(file), name)
        if not writer.Save():
            raise FormatError("the package cannot be written", path=path)


def _stem(path: Path) -> str:
    kept = "".join(c if c.isalnum() or c in "_-." else "_" for c in path.stem)
    return kept.encode("ascii", "replace").decode().replace("?", "_") or "scene"


class _Writer:
    def __init__(
        self,
        usd: Any,
        scene: Scene,
        unit_m: float,
        rate_hz: float | None,
        pictures: dict[str, bytes],
        prefix: str,
        notes: Notes,
    ) -> None:
        self._usd, self._scene, self._notes = usd, scene, notes
        self._unit_m, self._scale = unit_m, 1.0 / unit_m
        self._rate = common_rate(scene.animations) if rate_hz is None else float(rate_hz)
        self._pictures, self._prefix = pictures, prefix
        self._stage: Any = None
        self._place = 0

    def stage(self) -> Any:
        """The whole scene."""
        usd, scene = self._usd, self._scene
        self._stage = stage = usd.Usd.Stage.CreateInMemory()
        usd.UsdGeom.SetStageUpAxis(stage, usd.UsdGeom.Tokens.y)
        usd.UsdGeom.SetStageMetersPerUnit(stage, self._unit_m)
        stage.SetTimeCodesPerSecond(self._rate)
        stage.SetFramesPerSecond(self._rate)
        stage.GetRootLayer().customLayerData = {"creator": f"keypose {keypose.__version__}"}
        above, names = "", Names()
        if len(scene.characters) != 1:
            above = "/Scene"
            kind = usd.UsdGeom.Xform if scene.characters else usd.UsdGeom.Scope  # an Xform alone would be a joint
            stage.SetDefaultPrim(kind.Define(stage, above).GetPrim())
        if len(scene.characters) > 1:
            self._notes.add(f"{len(scene.characters)} characters are read back as the joints of one")
        written = [self._character(character, above, names) for character in scene.characters]
        if len(written) == 1:
            stage.SetDefaultPrim(stage.GetPrimAtPath(written[0].root))
        animations = AnimationWriter(usd, stage, written, self._rate, self._scale, self._notes)
        for animation in scene.animations:
            animations.add(animation)
        animations.finish()
        if animations.span is not None:
            stage.SetStartTimeCode(animations.span[0])
            stage.SetEndTimeCode(animations.span[1])
        for name, items in (("marker sets", scene.markers), ("signals", scene.signals), ("force plates", scene.plates)):
            if items:
                self._notes.add(f"{len(items)} {name} were dropped: USD has no place for them")
        return stage

    def _character(self, character: Character, above: str, names: Names) -> Written:
        usd, stage = self._usd, self._stage
        root = f"{above}/{names.add(character.name, 'Character')}"
        schema = usd.UsdSkel.Root.Define(stage, root)
        entitle(schema.GetPrim(), character.name)
        usd.Usd.ModelAPI(schema.GetPrim()).SetKind("component")
        below = Names()
        for taken in ("Materials", "Animations"):
            below.add(taken, taken)
        skeletons = SkeletonWriter(usd, character, self._scale, self._notes)
        prims = skeletons.write(stage, root, below)
        materials = MaterialWriter(usd, stage, f"{root}/Materials", self._pictures, self._prefix, self._notes)
        surfaces = SurfaceWriter(usd, stage, materials, skeletons.tokens, self._scale, self._notes)
        for part in character.parts:
            path = f"{root}/{below.add(part.name, 'Mesh')}"
            surfaces.add(character, part, skeletons.bound(part), path, self._place)
            self._place += 1
        schema.CreateExtentAttr(self._extent(character))
        shown = {int(c) for p in character.parts if p.morph_channels is not None for c in p.morph_channels}
        if any(np.asarray(character.rest_morph_weights)[m] for m in shown):
            self._notes.add(
                f"character '{character.name}': some morphs do not rest at 0, which only keypose reads; "
                "other programs have weights in animations alone"
            )
        return Written(character, skeletons.tokens, prims, root)

    def _extent(self, character: Character) -> Any:
        """The box of the character at rest."""
        skeleton = character.skeleton
        placed = np.asarray(world(skeleton, skeleton.rest), np.float64)
        clouds = [np.asarray(deform_part(character, part, placed)) for part in character.parts]
        clouds = [cloud for cloud in clouds if len(cloud)] or [placed[:, :3, 3]]
        points = np.concatenate(clouds) if len(clouds[0]) else np.zeros((1, 3))
        return vectors(self._usd, np.stack([points.min(axis=0), points.max(axis=0)]) * self._scale)
