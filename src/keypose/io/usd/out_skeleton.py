"""Joints of a character as UsdSkel skeletons, with bind transforms that suit the skins of its parts."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from keypose.arrays import Floats
from keypose.evaluate import world
from keypose.io.notes import Notes
from keypose.io.usd.library import Names, identifier, keep, matrix
from keypose.math import quat, rigid
from keypose.model import Character, Part, Skeleton, Skin

_SAME = 2e-7  # metres and ratios by which two bind transforms may differ and be one


@dataclass(slots=True)
class _Variant:
    """Bind transforms (4, 4) by joint; a joint is bound in one way in each skeleton."""

    bind: dict[int, Floats] = field(default_factory=dict[int, Floats])
    path: str = ""


@dataclass(frozen=True, slots=True)
class Bound:
    """How a part is bound: the path of its skeleton, and the transform of its points when it was bound."""

    skeleton: str
    geometry: Floats


class SkeletonWriter:
    """Writes the skeletons of one character: the same joints, as often as skins disagree about how they were bound."""

    def __init__(self, usd: Any, character: Character, scale: float, notes: Notes) -> None:
        self._usd, self._character, self._scale, self._notes = usd, character, scale, notes
        self.tokens = joint_tokens(character.skeleton)
        skeleton = character.skeleton
        rest = skeleton.rest
        local = (np.asarray(a, np.float64) for a in (rest.translations, rest.rotations, rest.scales))
        translations, rotations, scales = local
        self._local = np.asarray(rigid.from_trs(translations, quat.normalize(rotations), scales))
        self._world = np.asarray(world(skeleton, rest), np.float64)
        self._variants = [_Variant()]
        self._of_part: dict[int, tuple[_Variant, Floats]] = {}
        for part in character.parts:
            self._of_part[id(part)] = self._fitting(part)

    def bound(self, part: Part) -> Bound:
        """How a part is bound, once the skeletons are written."""
        variant, geometry = self._of_part[id(part)]
        return Bound(variant.path, geometry)

    def write(self, stage: Any, root: str, names: Names) -> list[Any]:
        """The skeletons below a root; returns their prims."""
        return [self._write(stage, root, names, variant) for variant in self._variants]

    def _fitting(self, part: Part) -> tuple[_Variant, Floats]:
        skin = part.skin
        if skin is None:
            joint = part.joint or 0
            bind = self._variants[0].bind.setdefault(joint, self._rest(joint, part.name))
            return self._variants[0], bind
        wanted = self._wanted(skin, part.name)
        for variant in self._variants:
            known = [j for j in wanted if j in variant.bind]
            geometry = variant.bind[known[0]] @ np.linalg.inv(wanted[known[0]]) if known else np.eye(4)
            if np.abs(geometry - np.eye(4)).max() < _SAME:
                geometry = np.eye(4)
            if all(np.abs(geometry @ wanted[j] - variant.bind[j]).max() < _SAME for j in known):
                variant.bind |= {j: geometry @ m for j, m in wanted.items() if j not in variant.bind}
                return variant, geometry
        self._variants.append(_Variant(wanted))
        return self._variants[-1], np.eye(4)

    def _wanted(self, skin: Skin, name: str) -> dict[int, Floats]:
        """Bind transforms of a skin's joints in the space of its mesh."""
        wanted: dict[int, Floats] = {}
        for joint, joint_from_mesh in zip(
            skin.palette.tolist(), np.asarray(skin.joint_from_mesh, np.float64), strict=True
        ):
            if abs(np.linalg.det(joint_from_mesh[:3, :3])) > 1e-18:
                wanted[joint] = np.linalg.inv(joint_from_mesh)
            else:
                self._notes.add(
                    f"part '{name}': an inverse bind matrix flattens the mesh; the rest pose stands in for its bind pose"
                )
                wanted[joint] = self._rest(joint, name)
        return wanted

    def _rest(self, joint: int, name: str) -> Floats:
        """Where a joint is at rest, for one that no skin has bound."""
        found = self._world[joint]
        if abs(np.linalg.det(found[:3, :3])) > 1e-18:
            return found
        return np.eye(4)

    def _write(self, stage: Any, root: str, names: Names, variant: _Variant) -> Any:
        usd, skeleton = self._usd, self._character.skeleton
        variant.path = f"{root}/{names.add('Skeleton', 'Skeleton')}"
        schema = usd.UsdSkel.Skeleton.Define(stage, variant.path)
        prim = schema.GetPrim()
        usd.UsdSkel.BindingAPI.Apply(prim)
        schema.CreateJointsAttr(usd.Vt.TokenArray(self.tokens))
        if [t.rpartition("/")[2] for t in self.tokens] != list(skeleton.names):
            schema.CreateJointNamesAttr(usd.Vt.TokenArray(list(skeleton.names)))
        bind = [variant.bind.get(j, self._rest(j, "")) for j in range(skeleton.joint_count)]
        schema.CreateBindTransformsAttr(usd.Vt.Matrix4dArray([matrix(usd, m, self._scale) for m in bind]))
        schema.CreateRestTransformsAttr(usd.Vt.Matrix4dArray([matrix(usd, m, self._scale) for m in self._local]))
        self._keep(prim)
        return prim

    def _keep(self, prim: Any) -> None:
        usd, character = self._usd, self._character
        roles, ends = dict(character.roles), character.skeleton.end_offsets
        if roles:
            keep(prim, roles=usd.Vt.StringArray(list(roles)), role_joints=usd.Vt.IntArray(list(roles.values())))
        if ends:
            offsets = [float(v) * self._scale for _, offset in ends for v in offset]
            keep(prim, end_joints=usd.Vt.IntArray([j for j, _ in ends]), end_offsets=usd.Vt.DoubleArray(offsets))
        if character.morph_names:
            weights = [float(w) for w in np.asarray(character.rest_morph_weights)]
            keep(
                prim,
                morphs=usd.Vt.StringArray(list(character.morph_names)),
                rest_weights=usd.Vt.DoubleArray(weights),
            )


def joint_tokens(skeleton: Skeleton) -> list[str]:
    """Paths of joints, ``hips/spine/head``, of names that USD allows."""
    tokens: list[str] = []
    below: dict[int, Names] = {}
    for joint, name in enumerate(skeleton.names):
        parent = int(skeleton.parents[joint])
        own = below.setdefault(parent, Names()).add(identifier(name, "joint"), "joint")
        tokens.append(own if parent < 0 else f"{tokens[parent]}/{own}")
    return tokens
