"""Small documents, random commands, and a disk that stops or loses what was not made safe."""

from __future__ import annotations

from typing import Any

import numpy as np

from keypose.model import (
    Attribute,
    Channel,
    Character,
    Clip,
    Constraint,
    ConstraintKind,
    Control,
    Curve,
    CurveKind,
    Document,
    Driver,
    Extrapolation,
    FollowModule,
    Image,
    Interpolation,
    Layer,
    LayerMode,
    Marker,
    Material,
    Mesh,
    MorphSet,
    Part,
    Placement,
    Pose,
    Property,
    Rig,
    Skeleton,
    Skin,
    StoredPose,
    Timeline,
)
from keypose.project import commands as c


def small_character(name: str = "tube") -> Character:
    """Three joints, a skinned triangle strip with a morph and a picture, and a box on a joint."""
    rest = Pose(np.array([[0, 0, 0], [0, 0.5, 0], [0, 0.5, 0]]), np.tile([1.0, 0, 0, 0], (3, 1)), np.ones((3, 3)))
    skeleton = Skeleton(("Root", "Mid", "Tip"), np.array([-1, 0, 1]), rest, ((2, (0.0, 0.25, 0.0)),))
    mesh = Mesh(
        np.arange(18, dtype=np.float32).reshape(6, 3),
        np.array([[0, 1, 2], [2, 1, 3], [3, 4, 5]]),
        uvs=np.linspace(0, 1, 12, dtype=np.float32).reshape(6, 2),
        attributes={"TEXCOORD_1": np.zeros((6, 2), np.float32)},
    )
    skin = Skin(np.arange(3), np.tile(np.eye(4), (3, 1, 1)), np.tile([0, 1], (6, 1)), np.tile([0.25, 0.75], (6, 1)))
    morphs = MorphSet.from_dense(("wide",), np.ones((1, 6, 3), np.float32) * np.array([[[0], [0], [1], [1], [0], [2]]]))
    image = Image("checks", "image/png", bytes(range(64)))
    clay = Material(
        "clay", (0.5, 0.25, 0.125, 1.0), base_color_image=image, extras={"ior": 1.5, "ids": (1, 2), "blob": b"\0\1"}
    )
    parts = (
        Part("skin", mesh, clay, skin, morphs=morphs, morph_channels=np.array([0])),
        Part("again", mesh, clay, skin),
        Part("box", Mesh(np.eye(3), np.array([[0, 1, 2]])), joint=2, extras={"weights": np.arange(4.0)}),
    )
    return Character(
        skeleton, parts, name, ("wide",), np.array([0.5], np.float32), {"hips": 0}, {"note": "äöü", "none": None}
    )


def random_curve(rng: np.random.Generator, kind: CurveKind = CurveKind.VECTOR) -> Curve:
    """Any modes that the kind allows, with tangents, handles and types."""
    count = int(rng.integers(1, 6))
    width = {CurveKind.VECTOR: 3, CurveKind.ROTATION: 4, CurveKind.EULER: 3, CurveKind.COLOR: 4}.get(kind, 1)
    times = np.cumsum(rng.random(count) + 0.01)
    values = rng.normal(size=(count, width))
    if kind is CurveKind.BOOLEAN:
        return Curve(times, values > 0, Interpolation.STEP, kind=kind)
    if kind is CurveKind.ROTATION:
        values /= np.linalg.norm(values, axis=1, keepdims=True)
        modes = rng.choice([0, 1, 2, 4, 5, 6], count)
        return Curve(times, values, modes, rng.normal(size=values.shape), rng.normal(size=values.shape), kind)
    sides = [rng.normal(size=(count, width, 2)) for _ in range(2)]
    return Curve(
        times,
        values.astype(rng.choice([np.float32, np.float64])),
        rng.integers(0, 4, count),
        rng.normal(size=values.shape),
        rng.normal(size=values.shape),
        kind,
        Extrapolation(rng.choice([e.value for e in Extrapolation])),
        Extrapolation.HOLD,
        np.abs(sides[0]) * [-1, 1],
        np.abs(sides[1]),
        rng.integers(0, 6, (count, 2)),
    )


_CHANNELS = [
    (Channel("Root", Property.TRANSLATION), CurveKind.VECTOR),
    (Channel("Mid", Property.ROTATION), CurveKind.ROTATION),
    (Channel("Tip", Property.EULER), CurveKind.EULER),
    (Channel("Tip", Property.SCALE, 1), CurveKind.SCALAR),
    (Channel("wide", Property.WEIGHT), CurveKind.SCALAR),
    (Channel("light", Property.VALUE), CurveKind.COLOR),
    (Channel("shown", Property.VALUE), CurveKind.BOOLEAN),
]


def random_curves(rng: np.random.Generator) -> dict[Channel, Curve]:
    chosen = rng.permutation(len(_CHANNELS))[: rng.integers(1, len(_CHANNELS) + 1)]
    return {_CHANNELS[i][0]: random_curve(rng, _CHANNELS[i][1]) for i in chosen}


def random_timeline(rng: np.random.Generator, name: str, clips: list[str]) -> Timeline:
    layers = tuple(
        Layer(
            f"layer {n}",
            tuple(
                Placement(
                    str(rng.choice(clips)),
                    float(rng.normal()),
                    None if rng.random() < 0.5 else 0.0,
                    None,
                    float(rng.uniform(0.1, 2)),
                    fade_in_s=float(rng.random()),
                    weight=random_curve(rng, CurveKind.SCALAR) if rng.random() < 0.3 else None,
                    hold=bool(rng.random() < 0.5),
                )
                for _ in range(rng.integers(0, 3) if clips else 0)
            ),
            LayerMode.ADD if rng.random() < 0.5 else LayerMode.REPLACE,
            random_curve(rng, CurveKind.SCALAR) if rng.random() < 0.3 else float(rng.random()),
            {"Mid": float(rng.random())} if rng.random() < 0.5 else {},
            frozenset({Property.ROTATION, Property.EULER}) if rng.random() < 0.3 else None,
            locked=bool(rng.random() < 0.5),
        )
        for n in range(rng.integers(1, 4))
    )
    return Timeline(layers, name, 24.0, -1.0, 3.5, int(rng.integers(0, 4)), (Marker(0.1, "hit"),))


def random_pose(rng: np.random.Generator, name: str) -> StoredPose:
    pose = Pose(rng.normal(size=(2, 3)), rng.normal(size=(2, 4)), rng.normal(size=(2, 3)))
    return StoredPose(name, ("Mid", "Tip"), pose, {"wide": float(rng.random())})


def small_rig(rng: np.random.Generator, name: str, character: str) -> Rig:
    """Two controls of a small character, a constraint, a driver."""
    rest = Pose(rng.normal(size=(2, 3)), np.tile([1.0, 0, 0, 0], (2, 1)), np.ones((2, 3)))
    return Rig(
        name,
        character,
        Skeleton(("base", "tip_control"), np.array([-1, 0]), rest),
        (Control("base"), Control("tip_control", size_m=float(rng.uniform(0.1, 1)))),
        (Attribute("bend", "base", float(rng.random())),),
        (FollowModule("all", ("Root", "Tip"), ("base", "tip_control")),),
        (Constraint("aim", ConstraintKind.AIM, "Mid", ("tip_control",), weight_attribute="bend"),),
        (Driver(Channel("tip_control", Property.EULER, 0), "bend * 2", random_curve(rng, CurveKind.SCALAR)),),
    )


def random_commands(rng: np.random.Generator, document: Document, *, page: bool = False) -> list[c.Command]:
    """One to three commands that can be applied to a document, one after the other; with ``page``, such as pages send."""
    made: list[c.Command] = []
    for _ in range(rng.integers(1, 4)):
        command = _random_command(rng, document, page)
        document = command.apply(document)
        made.append(command)
    return made


def _random_command(rng: np.random.Generator, document: Document, page: bool) -> c.Command:
    def one_of(mapping: Any) -> str:
        return str(rng.choice(list(mapping)))

    clips, timelines, poses = document.clips, document.timelines, document.poses
    choices: list[Any] = [
        lambda: c.SetCurves(
            str(rng.choice(["arm", "leg", "Geste äöü"])), random_curves(rng), euler_orders={"Tip": "ZYX"}
        ),
        lambda: c.SetClip(Clip(random_curves(rng), f"clip {rng.integers(4)}", 30.0)),
        lambda: c.SetTimeline(random_timeline(rng, f"take {rng.integers(3)}", list(clips))),
        lambda: c.SetPose(random_pose(rng, f"pose {rng.integers(3)}")),
        lambda: c.SetSettings({"zoom": float(rng.random()), f"flag {rng.integers(3)}": bool(rng.random() < 0.5)}),
        lambda: c.SetSettings({"zoom": None, "text": "x" * int(rng.integers(0, 9))}),
        lambda: c.Rename("project", document.name, f"project {rng.integers(100)}"),
    ]
    if len(document.characters) < 3 and not page:
        choices.append(lambda: c.AddCharacter(small_character()))
    if clips:
        choices += [
            lambda: c.RemoveClip(one_of(clips)),
            lambda: _removal(rng, document, one_of(clips)),
            lambda: c.Rename("clip", one_of(clips), f"renamed {rng.integers(1 << 30)}"),
        ]
    if timelines:
        choices += [
            lambda: c.RemoveTimeline(one_of(timelines)),
            lambda: c.Rename("timeline", one_of(timelines), f"renamed {rng.integers(1 << 30)}"),
        ]
    if poses:
        choices.append(lambda: c.RemovePose(one_of(poses)))
    if document.characters:
        choices += [
            lambda: c.Rename("character", one_of(document.characters), f"renamed {rng.integers(1 << 30)}"),
            lambda: c.SetPerformance(one_of(document.characters), one_of(timelines) if timelines else ""),
        ]
        if not page:
            choices.append(lambda: c.RemoveCharacter(one_of(document.characters)))
            bare = [name for name in document.characters if document.rig_of(name) is None]
            if bare:
                choices.append(lambda: c.SetRig(small_rig(rng, f"rig {rng.integers(1 << 30)}", str(rng.choice(bare)))))
    if document.rigs:
        choices += [
            lambda: c.RemoveRig(one_of(document.rigs)),
            lambda: c.Rename("rig", one_of(document.rigs), f"renamed {rng.integers(1 << 30)}"),
        ]
    return choices[rng.integers(len(choices))]()


def _removal(rng: np.random.Generator, document: Document, clip: str) -> c.SetCurves:
    channels = list(document.clips[clip].curves)
    return c.SetCurves(clip, {}, tuple(ch for ch in channels if rng.random() < 0.5))


def random_document(seed: int, steps: int = 12) -> Document:
    """What random commands make of an empty document and a character."""
    rng = np.random.default_rng(seed)
    document = c.AddCharacter(small_character()).apply(Document("random"))
    for _ in range(steps):
        document = c.apply_all(document, random_commands(rng, document))
    return document
