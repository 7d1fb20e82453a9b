"""The built-in human for crowds: its levels of detail, and clothes that not everybody has."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from keypose import evaluate
from keypose.arrays import Floats
from keypose.model import Material, Pose
from keypose.play.levels import Level, LevelSpec, build
from keypose.samples import load

_INSIDE = ("upper_teeth", "lower_teeth", "tongue")
_TRIMMINGS = (*_INSIDE, "mouth", "lashes", "catchlights", "laces", "seams", "zip", "pockets")

SPECS = (
    LevelSpec(above=0.42, capacity=40),
    LevelSpec(0.40, 0.008, above=0.16, capacity=160, without=_INSIDE),
    LevelSpec(0.125, 0.03, 2, above=0.055, without=_TRIMMINGS),
    LevelSpec(0.05, 0.06, 4, without=_TRIMMINGS),
)
_IMPORTANCE = {
    "head": 8.0,
    "eyes": 16.0,
    "brows": 16.0,
    "hair": 1.5,
    "ears": 1.5,
    "hands": 1.5,
    "zip": 20.0,
    "star": 20.0,
    "pockets": 8.0,
}
_EXAMPLES = ("idle", "walk", "run", "jump", "wave")
_EACH = 12  # poses of each performance

_WORN = ("jacket", "sleeves", "ribbing", "shirt", "neckband", "trousers", "turn_ups", "sneakers")
_OUTFITS = (
    ("1F6F7A", "F1E4CB", "E9A63A", "E2603F", "C9502F", "2F3B5C", "6C80AC", "E2603F"),
    ("8C2F4B", "F3E6D8", "2E2A3A", "F0B646", "D99A2B", "3A3F4A", "5C6474", "F4EEE2"),
    ("35603F", "EDE3C8", "C9782F", "F2E9DA", "D8CBB4", "4A3B2E", "7A6550", "8A4B2A"),
    ("2B4C9B", "F2F2EE", "D94A3D", "F4F1E8", "D8D3C6", "23262F", "4C5160", "D94A3D"),
    ("D9A02E", "F4EBD6", "2F4858", "2F6D6A", "24504F", "33415E", "5D6F93", "2F4858"),
    ("7E6BB5", "F1EBF5", "F2B5A7", "FBF8FC", "E0DAE6", "3C3A55", "66648A", "F2B5A7"),
    ("E0735B", "F7E9DA", "2F5D62", "F3D27A", "DDB44F", "40506B", "7688A6", "F7E9DA"),
    ("3B3F46", "B9BEC6", "E2603F", "E8E4DA", "CFCABD", "5A6B7A", "8597A6", "2B2E33"),
    ("6FB7A0", "F6F3E8", "3D5A80", "EE9B75", "D67F58", "4B4E6D", "7C80A3", "3D5A80"),
    ("A6492D", "EAD9BD", "25424C", "25424C", "1B323A", "6B5B49", "94826C", "EAD9BD"),
    ("F0E4D0", "D6C3A1", "4F7C8A", "4F7C8A", "3D6472", "7C6A58", "A3927F", "4F7C8A"),
    ("C23B5A", "F5D9C6", "F2C14E", "FFF3E2", "E8D8C0", "2E4A62", "5B7C99", "F2C14E"),
)
_SKINS = ("F0B995", "F6CBAE", "E3A57E", "C98B62", "A86C47", "7D4E33", "5E3D2B")
_HAIRS = ("643527", "2B1D18", "1E1916", "8A5A33", "C79A5B", "A8452A", "6E6660", "D9C08C")


@cache
def levels() -> tuple[Level, ...]:
    """The levels of detail of the built-in human, with what its performances do as examples; built once per process."""
    return build(load("human").character, SPECS, examples(), _IMPORTANCE)


def examples() -> Pose:
    """Poses of the performances that a crowd plays."""
    human = load("human")
    found: list[Pose] = []
    for name in _EXAMPLES:
        motion = human.animation(name)
        end = motion.start_s + motion.duration_s
        times = np.linspace(motion.start_s, end, _EACH, endpoint=False)
        found.append(evaluate.sample(motion, human.character.skeleton, times))
    joined = (np.concatenate([getattr(p, field) for p in found]) for field in ("translations", "rotations", "scales"))
    return Pose(*joined)


def outfits(materials: Sequence[Material], count: int, seed: int = 0) -> Floats:
    """A colour of each material for each of ``count`` people, linear RGB (count, M, 3); the first wears what the human does."""
    rng = np.random.default_rng(seed)
    names = [m.name for m in materials]
    colors = np.tile(np.array([m.base_color[:3] for m in materials], np.float64), (count, 1, 1))
    worn = np.array([[_linear(code) for code in outfit] for outfit in _OUTFITS])
    skins, hairs = (np.array([_linear(code) for code in codes]) for codes in (_SKINS, _HAIRS))
    # A shuffled deck, again and again: neighbours in number never wear the same.
    decks = -(-count // len(worn))
    which = np.concatenate([rng.permutation(len(worn)) for _ in range(decks)])[:count]
    skin, hair = rng.integers(0, len(skins), count), rng.integers(0, len(hairs), count)
    # Fair hair goes with fair skin more often than not.
    hair = np.where((skin > 3) & (hair > 2) & (rng.random(count) < 0.85), 1 + hair % 2, hair)
    light = rng.uniform(0.88, 1.1, (count, 1))
    chosen = dict(zip(_WORN, np.moveaxis(worn[which], 1, 0), strict=True)) | {"skin": skins[skin], "hair": hairs[hair]}
    chosen["brows"] = 0.55 * hairs[hair]
    for name, values in chosen.items():
        if name in names:
            shade = 1.0 if name == "skin" else light
            colors[1:, names.index(name)] = np.clip(values * shade, 0, 1)[1:]
    return colors


def _linear(code: str) -> list[float]:
    values = [int(code[i : i + 2], 16) / 255 for i in (0, 2, 4)]
    return [v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in values]
