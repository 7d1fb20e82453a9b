"""Real characters and takes go into projects and come out again bit for bit."""

from __future__ import annotations

from pathlib import Path

import pytest

from keypose import io
from keypose.errors import KeyposeError
from keypose.evaluate.performing import perform, to_document
from keypose.io import native

LARGEST = 4_000_000


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["glb", "gltf", "vrm", "fbx", "bvh", "dae", "amc"])
def test_what_real_files_hold_survives_in_a_project(suffix: str, data_dir: Path) -> None:
    seen = 0
    for path in sorted(data_dir.rglob(f"*.{suffix}")):
        if path.stat().st_size > LARGEST or seen == 12:
            continue
        try:
            scene = io.load(path)
        except KeyposeError:
            continue  # kept there for being malformed
        if not scene.characters:
            continue
        seen += 1
        document = to_document(scene, path.stem)
        data = native.document_bytes(document)
        read = native.document_from_bytes(data)
        assert native.document_bytes(read) == data, path
        for one, two in zip(document.characters.values(), read.characters.values(), strict=True):
            assert one.extras.keys() == two.extras.keys(), path
            for mine, theirs in zip(one.parts, two.parts, strict=True):
                assert mine.material.extras.keys() == theirs.material.extras.keys(), path
                assert mine.mesh.attributes.keys() == theirs.mesh.attributes.keys(), path
        names = [a.name for a in perform(read).animations]
        assert sorted(names) == sorted(document.clips), path
    if seen == 0:
        pytest.skip(f"no .{suffix} files of at most {LARGEST / 1e6:g} MB")
