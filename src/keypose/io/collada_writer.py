"""Writing COLLADA 1.4.1: characters with meshes, skins, morphs, colours and animation, in metres with Y up.

Joints are nodes with one matrix each, and animation is that matrix along time: what every reader of the format understands.

Source: COLLADA 1.4.1 specification (Khronos), and the choices that Blender's and FBX's exporters make within it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from keypose.arrays import Floats, Ints
from keypose.errors import FormatError
from keypose.io.atomic import replacing
from keypose.io.collada_animation import refined
from keypose.io.notes import beyond_meshes
from keypose.math import rigid
from keypose.model import (
    Channel,
    Character,
    Clip,
    Curve,
    Interpolation,
    Material,
    Motion,
    Part,
    Property,
    Scene,
    SkinningMethod,
)

_DEFAULT_RATE_HZ = 30.0
_MOVES = (Property.TRANSLATION, Property.ROTATION)
_XML = re.compile(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")  # what XML cannot hold


def write(scene: Scene, path: Path, *, rate_hz: float | None = None) -> tuple[str, ...]:
    """Write all characters of a scene and, of the first, all animations; returns notes of what was left out.

    Shapes and units: clips keep their keys, with more where their curves are no lines; ``rate_hz`` samples everything.

    Raises:
        FormatError: where there is no character, or the place cannot be written.
    """
    if not scene.characters:
        raise FormatError("there is no character to write", path=path)
    writer = _Writer(scene, rate_hz)
    with replacing(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as file:
        file.writelines(writer.document())
    return tuple(dict.fromkeys(writer.notes))


@dataclass(slots=True)
class _Ids:
    """Ids that XML allows, each once."""

    taken: set[str] = field(default_factory=set[str])

    def make(self, name: str, suffix: str = "") -> str:
        stem = re.sub(r"[^A-Za-z0-9_.-]", "_", name)[:80]
        if not stem or not (stem[0].isalpha() or stem[0] == "_"):
            stem = f"_{stem}"
        made, number = stem + suffix, 1
        while made in self.taken:
            number += 1
            made = f"{stem}_{number}{suffix}"
        self.taken.add(made)
        return made


class _Writer:
    def __init__(self, scene: Scene, rate_hz: float | None) -> None:
        self.scene, self.rate_hz = scene, rate_hz
        self.ids, self.notes = _Ids({"Scene"}), list[str]()
        self.effects: list[str] = []
        self.materials: list[str] = []
        self.images: list[str] = []
        self.geometries: list[str] = []
        self.controllers: list[str] = []
        self.animations: list[str] = []
        self.clips: list[str] = []
        self.nodes: list[str] = []
        self.material_ids: dict[int, str] = {}
        self.weights_of: dict[str, list[tuple[str, int]]] = {}  # of each morph channel: sources of weights and places

    def document(self) -> Iterator[str]:
        for number, character in enumerate(self.scene.characters):
            self.character(character, animated=number == 0)
        yield '<?xml version="1.0" encoding="utf-8"?>\n'
        yield '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">\n'
        yield "<asset><contributor><authoring_tool>keypose</authoring_tool></contributor>"
        # a fixed moment: the same scene gives the same bytes
        yield "<created>2000-01-01T00:00:00Z</created><modified>2000-01-01T00:00:00Z</modified>"
        yield '<unit meter="1" name="meter"/><up_axis>Y_UP</up_axis></asset>\n'
        for name, items in (
            ("library_images", self.images),
            ("library_effects", self.effects),
            ("library_materials", self.materials),
            ("library_geometries", self.geometries),
            ("library_controllers", self.controllers),
            ("library_animations", self.animations),
            ("library_animation_clips", self.clips),
        ):
            if items:
                yield f"<{name}>\n"
                yield from items
                yield f"</{name}>\n"
        title = _quoted(self.scene.characters[0].name)
        yield f'<library_visual_scenes><visual_scene id="Scene" name={title}>\n'
        yield from self.nodes
        yield '</visual_scene></library_visual_scenes>\n<scene><instance_visual_scene url="#Scene"/></scene>\n</COLLADA>\n'

    # --- one character ------------------------------------------------------------------------------------------------------

    def character(self, character: Character, *, animated: bool) -> None:
        skeleton = character.skeleton
        ids = [self.ids.make(name) for name in skeleton.names]
        if skeleton.end_offsets:
            self.notes.append(
                f"tips of {len(skeleton.end_offsets)} joints are not in the file: COLLADA has joints only"
            )
        if character.extras or character.roles:
            self.notes.append("roles and what other formats kept with the character are not in the file")
        self.notes += beyond_meshes(character)
        rest_weights = np.asarray(character.rest_morph_weights, np.float64)
        hung: dict[int, list[str]] = {}
        skinned: list[str] = []
        for part in character.parts:
            instance = self.part(part, ids, rest_weights, character.morph_names)
            if part.skin is None and part.joint is not None:
                hung.setdefault(part.joint, []).append(instance)
            else:
                skinned.append(
                    f"<node id={_quoted(self.ids.make(part.name, '-node'))} name={_quoted(part.name)}>{instance}</node>\n"
                )
        local = np.asarray(rigid.from_trs(skeleton.rest.translations, skeleton.rest.rotations, skeleton.rest.scales))
        self.nodes += _tree(skeleton.parents, skeleton.names, ids, np.asarray(local, np.float64), hung)
        self.nodes += skinned
        if animated:
            titles = _Ids()
            for animation in self.scene.animations:
                self.animation(animation, character, ids, titles)
        elif self.scene.animations:
            self.notes.append("animations were written for the first character only")

    def part(self, part: Part, joint_ids: Sequence[str], rest_weights: Floats, channels: Sequence[str]) -> str:
        """The geometry, controllers and material of a part; returns the instance that shows it."""
        stem = self.ids.make(part.name)
        geometry = self.geometry(part, stem)
        source, controller = geometry, ""
        if part.morphs is not None and len(part.morphs.names):
            controller = source = self.morph(part, stem, geometry, rest_weights, channels)
        if part.skin is not None:
            controller = self.skin(part, stem, source, joint_ids)
        bind = (
            "<bind_material><technique_common>"
            f'<instance_material symbol="material" target={_quoted("#" + self.material(part.material))}>'
            '<bind_vertex_input semantic="UVMAP" input_semantic="TEXCOORD" input_set="0"/>'
            "</instance_material></technique_common></bind_material>"
        )
        if not controller:
            return f"<instance_geometry url={_quoted('#' + geometry)}>{bind}</instance_geometry>\n"
        root = "" if part.skin is None else f"<skeleton>#{joint_ids[0]}</skeleton>"
        return f"<instance_controller url={_quoted('#' + controller)}>{root}{bind}</instance_controller>\n"

    def geometry(self, part: Part, stem: str) -> str:
        mesh, name = part.mesh, self.ids.make(stem, "-mesh")
        sources = [_source(f"{name}-positions", mesh.positions, "XYZ")]
        inputs = [f'<input semantic="VERTEX" source="#{name}-vertices" offset="0"/>']
        if mesh.normals is not None:
            sources.append(_source(f"{name}-normals", mesh.normals, "XYZ"))
            inputs.append(f'<input semantic="NORMAL" source="#{name}-normals" offset="0"/>')
        maps: list[tuple[int, Any]] = [] if mesh.uvs is None else [(0, mesh.uvs)]
        for key, values in mesh.attributes.items():
            number = re.fullmatch(r"TEXCOORD_([1-9])", key)
            if number and np.asarray(values).ndim == 2 and np.asarray(values).shape[1] == 2:
                maps.append((int(number[1]), values))
            else:
                self.notes.append(f"vertex attribute {key} is not in the file")
        for number, values in maps:
            flipped = np.array(values, np.float64)
            flipped[:, 1] = 1 - flipped[:, 1]
            sources.append(_source(f"{name}-map-{number}", flipped, "ST"))
            inputs.append(f'<input semantic="TEXCOORD" source="#{name}-map-{number}" offset="0" set="{number}"/>')
        if mesh.colors is not None:
            sources.append(_source(f"{name}-colors", mesh.colors, "RGBA"))
            inputs.append(f'<input semantic="COLOR" source="#{name}-colors" offset="0"/>')
        triangles = np.asarray(mesh.triangles)
        self.geometries.append(
            f"<geometry id={_quoted(name)} name={_quoted(part.name)}><mesh>\n{''.join(sources)}"
            f'<vertices id="{name}-vertices"><input semantic="POSITION" source="#{name}-positions"/></vertices>\n'
            f'<triangles count="{len(triangles)}" material="material">{"".join(inputs)}<p>{_integers(triangles)}</p></triangles>\n'
            "</mesh></geometry>\n"
        )
        return name

    def morph(self, part: Part, stem: str, geometry: str, rest_weights: Floats, channels: Sequence[str]) -> str:
        name = self.ids.make(stem, "-morph")
        morphs, driven = part.morphs, part.morph_channels
        if morphs is None or driven is None:
            raise FormatError(f"part '{part.name}' has no morphs")
        if morphs.normal_deltas is not None:
            self.notes.append("normals of morph targets are not in the file")
        targets: list[str] = []
        positions = np.asarray(part.mesh.positions, np.float64)
        for index in range(len(morphs.names)):
            channel = channels[int(driven[index])]
            target = self.ids.make(f"{stem}-{channel}", "-target")
            rows = slice(int(morphs.starts[index]), int(morphs.starts[index + 1]))
            moved = positions.copy()
            moved[morphs.vertices[rows]] += morphs.position_deltas[rows]
            self.geometries.append(
                f"<geometry id={_quoted(target)} name={_quoted(channel)}><mesh>\n{_source(f'{target}-positions', moved, 'XYZ')}"
                f'<vertices id="{target}-vertices"><input semantic="POSITION" source="#{target}-positions"/></vertices>\n'
                f'<triangles count="0"><input semantic="VERTEX" source="#{target}-vertices" offset="0"/><p></p></triangles>\n'
                "</mesh></geometry>\n"
            )
            targets.append(target)
            self.weights_of.setdefault(channel, []).append((f"{name}-weights", index))
        count = len(targets)
        self.controllers.append(
            f'<controller id={_quoted(name)} name={_quoted(part.name)}><morph source="#{geometry}" method="NORMALIZED">\n'
            f'<source id="{name}-targets"><IDREF_array id="{name}-targets-array" count="{count}">{" ".join(targets)}</IDREF_array>'
            f'<technique_common><accessor source="#{name}-targets-array" count="{count}" stride="1">'
            '<param name="IDREF" type="IDREF"/></accessor></technique_common></source>\n'
            f"{_source(f'{name}-weights', rest_weights[driven][:, None], ('MORPH_WEIGHT',))}"
            f'<targets><input semantic="MORPH_TARGET" source="#{name}-targets"/>'
            f'<input semantic="MORPH_WEIGHT" source="#{name}-weights"/></targets>\n</morph></controller>\n'
        )
        return name

    def skin(self, part: Part, stem: str, source: str, joint_ids: Sequence[str]) -> str:
        name = self.ids.make(stem, "-skin")
        skin = part.skin
        if skin is None:
            raise FormatError(f"part '{part.name}' has no skin")
        if skin.method is not SkinningMethod.LINEAR:
            self.notes.append(f"part '{part.name}': its skin asks for dual quaternions; COLLADA has linear skins only")
        weights, joints = np.asarray(skin.weights, np.float64), np.asarray(skin.joints)
        used = weights > 0
        counts = used.sum(axis=1)
        values = weights[used]
        pairs = np.stack([joints[used], np.arange(len(values))], axis=1)
        words = " ".join(joint_ids[int(j)] for j in skin.palette)
        count = len(skin.palette)
        matrices = np.asarray(skin.joint_from_mesh, np.float64).reshape(count, 16)
        self.controllers.append(
            f'<controller id={_quoted(name)} name={_quoted(part.name)}><skin source="#{source}">\n'
            "<bind_shape_matrix>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</bind_shape_matrix>\n"
            f'<source id="{name}-joints"><Name_array id="{name}-joints-array" count="{count}">{words}</Name_array>'
            f'<technique_common><accessor source="#{name}-joints-array" count="{count}" stride="1">'
            '<param name="JOINT" type="name"/></accessor></technique_common></source>\n'
            f"{_source(f'{name}-bind', matrices, ('TRANSFORM',), 'float4x4')}"
            f"{_source(f'{name}-weights', values[:, None], ('WEIGHT',))}"
            f'<joints><input semantic="JOINT" source="#{name}-joints"/><input semantic="INV_BIND_MATRIX" source="#{name}-bind"/></joints>\n'
            f'<vertex_weights count="{len(counts)}"><input semantic="JOINT" source="#{name}-joints" offset="0"/>'
            f'<input semantic="WEIGHT" source="#{name}-weights" offset="1"/>'
            f"<vcount>{_integers(counts)}</vcount><v>{_integers(pairs)}</v></vertex_weights>\n</skin></controller>\n"
        )
        return name

    def material(self, material: Material) -> str:
        if id(material) in self.material_ids:
            return self.material_ids[id(material)]
        name = self.ids.make(material.name or "material", "-material")
        effect = self.ids.make(material.name or "material", "-effect")
        self.material_ids[id(material)] = name
        red, green, blue, alpha = material.base_color
        parameters, diffuse = "", f"<color>{_floats([red, green, blue, alpha])}</color>"
        if material.base_color_image is not None:
            picture = material.base_color_image
            image = self.ids.make(picture.name or "picture", "-image")
            self.images.append(
                f"<image id={_quoted(image)}><init_from>{_text(picture.name or image)}</init_from></image>\n"
            )
            parameters = (
                f'<newparam sid="surface"><surface type="2D"><init_from>{image}</init_from></surface></newparam>'
                '<newparam sid="sampler"><sampler2D><source>surface</source></sampler2D></newparam>'
            )
            diffuse = '<texture texture="sampler" texcoord="UVMAP"/>'
            if picture.data is not None:
                self.notes.append(f"picture '{picture.name}' is named in the file, but its data is not in it")
        emission = f"<emission><color>{_floats([*material.emissive, 1.0])}</color></emission>"
        if material.unlit:
            emission = f"<emission>{diffuse}</emission>"
        body = (
            f"<constant>{emission}</constant>"
            if material.unlit
            else f"<lambert>{emission}<diffuse>{diffuse}</diffuse></lambert>"
        )
        sided = (
            '<extra><technique profile="GOOGLEEARTH"><double_sided>1</double_sided></technique></extra>'
            if material.double_sided
            else ""
        )
        if material.metallic or alpha != 1 or material.alpha_mode != "OPAQUE":
            self.notes.append("metal and transparency of materials are not in the file")
        self.effects.append(
            f'<effect id={_quoted(effect)}><profile_COMMON>{parameters}<technique sid="common">{body}</technique></profile_COMMON>{sided}</effect>\n'
        )
        self.materials.append(
            f"<material id={_quoted(name)} name={_quoted(material.name)}><instance_effect url={_quoted('#' + effect)}/></material>\n"
        )
        return name

    # --- animation ----------------------------------------------------------------------------------------------------------

    def animation(self, animation: Clip | Motion, character: Character, ids: Sequence[str], titles: _Ids) -> None:
        stem = self.ids.make(titles.make(animation.name or "animation"), "-animation")
        if isinstance(animation, Clip) and self.rate_hz is None:
            pieces, start, end = self.curves(animation, character, ids, stem)
        else:
            pieces, start, end = self.frames(animation, character, ids, stem)
        if not pieces:
            self.notes.append(f"animation '{animation.name}' has no frames and was left out")
            return
        self.animations.append(
            f"<animation id={_quoted(stem)} name={_quoted(animation.name)}>\n{''.join(pieces)}</animation>\n"
        )
        self.clips.append(
            f"<animation_clip id={_quoted(self.ids.make(stem, '-clip'))} name={_quoted(animation.name)} "
            f'start="{start:.10g}" end="{end:.10g}"><instance_animation url={_quoted("#" + stem)}/></animation_clip>\n'
        )
        if isinstance(animation, Motion) and animation.events:
            self.notes.append(f"events of animation '{animation.name}' are not in the file")

    def frames(
        self, animation: Clip | Motion, character: Character, ids: Sequence[str], stem: str
    ) -> tuple[list[str], float, float]:
        """Channels of the frames of a motion, or of a clip at the rate that was asked for."""
        from keypose import evaluate

        skeleton, rest_weights = character.skeleton, np.asarray(character.rest_morph_weights, np.float64)
        if isinstance(animation, Motion):
            motion = animation
            if motion.joint_names != skeleton.names:
                self.notes += evaluate.match_report(motion, skeleton).notes
                motion = evaluate.match(motion, skeleton)
        else:
            motion = evaluate.bake(evaluate.match(animation, skeleton), skeleton, self.rate_hz or _DEFAULT_RATE_HZ)
        if self.rate_hz is not None and motion.rate_hz != self.rate_hz:
            motion = evaluate.resample(motion, self.rate_hz)
        if motion.frame_count == 0:
            return [], 0.0, 0.0
        times, pose, rest = motion.times_s, motion.pose.broadcast(), skeleton.rest
        local = np.asarray(rigid.from_trs(pose.translations, pose.rotations, pose.scales), np.float64)
        still = np.asarray(rigid.from_trs(rest.translations, rest.rotations, rest.scales), np.float64)
        pieces: list[str] = []
        for joint in range(skeleton.joint_count):
            # one joint at least keeps the length of the animation
            if joint == 0 or np.abs(local[:, joint] - still[joint]).max() > 1e-12:
                values = local[:, joint].reshape(-1, 16)
                pieces.append(_channel(f"{stem}-{joint}", times, values, f"{ids[joint]}/transform"))
        if isinstance(animation, Clip):
            weights = np.asarray(evaluate.sample_morphs(animation, character.morph_names, times, rest_weights))
        else:
            weights = np.tile(rest_weights, (len(times), 1))
            for column, name in enumerate(motion.morph_names):
                if name in character.morph_names and motion.morph_weights is not None:
                    weights[:, character.morph_names.index(name)] = motion.morph_weights[:, column]
        for index, name in enumerate(character.morph_names):
            if np.any(weights[:, index] != rest_weights[index]):
                pieces += self.weight_channels(stem, index, name, times, weights[:, index])
        return pieces, float(times[0]), float(times[-1])

    def curves(self, clip: Clip, character: Character, ids: Sequence[str], stem: str) -> tuple[list[str], float, float]:
        """Channels with the keys of a clip, and more where its curves are no lines."""
        from keypose import evaluate

        skeleton, matched = character.skeleton, evaluate.match(clip, character.skeleton)
        rest = skeleton.rest
        pieces: list[str] = []
        for joint, name in enumerate(skeleton.names):
            own = {kind: matched.curves.get(Channel(name, kind)) for kind in (*_MOVES, Property.SCALE)}
            if not any(own.values()):
                continue
            still = (rest.translations[joint], rest.rotations[joint], rest.scales[joint])

            def at(times: Floats, own: Any = own, still: Any = still) -> tuple[Floats, ...]:
                return tuple(
                    np.tile(np.asarray(value, np.float64), (len(times), 1))
                    if curve is None
                    else np.asarray(evaluate.sample_curve(curve, times), np.float64)
                    for curve, value in zip(own.values(), still, strict=True)
                )

            times, words = _keys([curve for curve in own.values() if curve is not None], at)
            local = np.asarray(rigid.from_trs(*at(times)), np.float64).reshape(-1, 16)
            pieces.append(_channel(f"{stem}-{joint}", times, local, f"{ids[joint]}/transform", words))
        for index, name in enumerate(character.morph_names):
            curve = clip.curves.get(Channel(name, Property.WEIGHT))
            if curve is not None:
                times, words = _keys([curve], lambda t, c=curve: (np.asarray(evaluate.sample_curve(c, t), np.float64),))
                values = np.asarray(evaluate.sample_curve(curve, times), np.float64)[:, 0]
                pieces += self.weight_channels(stem, index, name, times, values, words)
        return pieces, clip.start_s, clip.end_s

    def weight_channels(
        self, stem: str, index: int, name: str, times: Floats, values: Floats, words: Sequence[str] = ()
    ) -> list[str]:
        return [
            _channel(f"{stem}-morph-{index}-{number}", times, values[:, None], f"{source}({place})", words)
            for number, (source, place) in enumerate(self.weights_of.get(name, ()))
        ]


def _keys(curves: Sequence[Curve], at: Callable[[Floats], tuple[Floats, ...]]) -> tuple[Floats, list[str]]:
    """The times of all curves together, more of them where they are no lines, and how each leads to the next."""
    times = np.unique(np.concatenate([curve.times_s for curve in curves]))
    steps = [np.asarray(curve.modes) == Interpolation.STEP for curve in curves]
    if all(step[:-1].all() and len(step) > 1 for step in steps):
        return times, ["STEP"] * len(times)
    # where only some curves step, a key just before the step keeps it one
    jumps = [curve.times_s[1:][step[:-1]] for curve, step in zip(curves, steps, strict=True)]
    jump = np.unique(np.concatenate(jumps))
    times = np.unique(np.concatenate([times, np.nextafter(jump.astype(np.float32), np.float32(-np.inf))]))
    times = refined(times, at)
    return times, ["LINEAR"] * len(times)


# --- pieces of XML ----------------------------------------------------------------------------------------------------------


def _tree(
    parents: Ints, names: Sequence[str], ids: Sequence[str], local: Floats, hung: dict[int, list[str]]
) -> Iterator[str]:
    """The nodes of a skeleton, children inside their parents, without recursion."""
    children: list[list[int]] = [[] for _ in names]
    roots: list[int] = []
    for joint, parent in enumerate(parents.tolist()):
        (children[parent] if parent >= 0 else roots).append(joint)
    stack = [(joint, False) for joint in reversed(roots)]
    while stack:
        joint, done = stack.pop()
        if done:
            yield "</node>\n"
            continue
        own = _quoted(ids[joint])
        yield (
            f'<node id={own} sid={own} name={_quoted(names[joint])} type="JOINT">'
            f'<matrix sid="transform">{_floats(local[joint].reshape(-1))}</matrix>\n'
        )
        yield from hung.get(joint, ())
        stack.append((joint, True))
        stack += [(child, False) for child in reversed(children[joint])]


def _channel(name: str, times: Floats, values: Floats, target: str, words: Sequence[str] = ()) -> str:
    count = len(times)
    parameter, kind = ("TRANSFORM", "float4x4") if values.shape[1] == 16 else ("X", "float")
    return (
        f"{_source(f'{name}-input', times[:, None], ('TIME',))}{_source(f'{name}-output', values, (parameter,), kind)}"
        f'<source id="{name}-interpolation"><Name_array id="{name}-interpolation-array" count="{count}">'
        f"{' '.join(words or ['LINEAR'] * count)}</Name_array><technique_common>"
        f'<accessor source="#{name}-interpolation-array" count="{count}" stride="1"><param name="INTERPOLATION" type="name"/>'
        f'</accessor></technique_common></source><sampler id="{name}-sampler"><input semantic="INPUT" source="#{name}-input"/>'
        f'<input semantic="OUTPUT" source="#{name}-output"/><input semantic="INTERPOLATION" source="#{name}-interpolation"/>'
        f'</sampler><channel source="#{name}-sampler" target={_quoted(target)}/>\n'
    )


def _source(name: str, values: Any, parameters: Iterable[str], kind: str = "float") -> str:
    table = np.asarray(values, np.float64)
    names = "".join(f'<param name="{p}" type="{kind}"/>' for p in parameters)
    return (
        f'<source id="{name}"><float_array id="{name}-array" count="{table.size}">{_floats(table.reshape(-1))}</float_array>'
        f'<technique_common><accessor source="#{name}-array" count="{len(table)}" stride="{table.shape[1]}">{names}'
        "</accessor></technique_common></source>\n"
    )


def _floats(values: Any) -> str:
    """Numbers with ten digits: more than float32 has, and below 1e-6 mm of a character."""
    flat = np.asarray(values, np.float64).reshape(-1)
    if not np.isfinite(flat).all():
        raise FormatError("a number that is not finite cannot be written")
    return " ".join(["%.10g"] * len(flat)) % tuple((flat + 0.0).tolist())


def _integers(values: Any) -> str:
    return " ".join(map(str, np.asarray(values).reshape(-1).tolist()))


def _text(text: str) -> str:
    return escape(_XML.sub("_", text))


def _quoted(text: str) -> str:
    return quoteattr(_XML.sub("_", text))
