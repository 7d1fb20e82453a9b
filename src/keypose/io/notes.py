"""What every reader and writer needs to say: notes, and names that appear once."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, cast

from keypose.model import Character


class UniqueNames:
    """Gives every name once: the second "arm" becomes "arm_2"."""

    def __init__(self, reserved: Iterable[str] = ()) -> None:
        self._taken = set(reserved)
        self._seen: set[str] = set()
        self._next: dict[str, int] = {}

    def add(self, name: str) -> str:
        """The name itself, or the next free one with a number."""
        new = name
        if name in self._seen:
            number = self._next.get(name, 2)
            while f"{name}_{number}" in self._seen or f"{name}_{number}" in self._taken:
                number += 1
            self._next[name] = number + 1
            new = f"{name}_{number}"
        self._seen.add(new)
        return new


class Notes:
    """What a reader or writer guessed, repaired or dropped; each text once, and no more than a reader can take in."""

    LIMIT = 200

    def __init__(self) -> None:
        self._texts: dict[str, None] = {}
        self._more = 0

    def add(self, text: str) -> None:
        """Keep one note."""
        if len(self._texts) < self.LIMIT:
            self._texts[text] = None
        elif text not in self._texts:
            self._more += 1

    def texts(self) -> tuple[str, ...]:
        """All notes in order of appearance."""
        return (*self._texts, *([f"{self._more} more notes of this kind"] if self._more else []))


def beyond_meshes(character: Character) -> list[str]:
    """What a character keeps of a glTF or VRM file that formats of joints, meshes and plain materials cannot hold."""
    notes: list[str] = []
    kept = _mapping(character.extras.get("vrm"))
    words = {
        "expressions": "expressions",
        "springBone": "spring bones",
        "lookAt": "look-at",
        "firstPerson": "first person",
        "meta": "licence",
    }
    said = [word for key, word in words.items() if key in kept]
    if said:
        notes.append(f"VRM: {', '.join(said)} are not in the file")
    names: set[str] = set()
    for part in character.parts:
        names.update(_mapping(_mapping(part.material.extras.get("gltf")).get("extensions")))
    names.discard("KHR_materials_unlit")  # which a material says itself
    if names:
        notes.append(f"material extensions are not in the file: {', '.join(sorted(names))}")
    return notes


def _mapping(value: Any) -> dict[str, Any]:
    return cast("dict[str, Any]", value) if isinstance(value, dict) else {}
