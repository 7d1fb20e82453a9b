"""Messages, their TypeScript twins, and the container they travel in."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from keypose.errors import FormatError
from keypose.studio import scene_messages
from keypose.studio.container import Body, array, pack, unpack
from keypose.studio.typescript import generate, target, typescript_type


def test_the_generated_typescript_is_up_to_date() -> None:
    assert target().read_text(encoding="utf-8") == generate(), "run: python -m keypose.studio.typescript"


@pytest.mark.parametrize(
    ("annotation", "spelling"),
    [
        (int, "number"),
        (list[float], "number[]"),
        (int | None, "number | null"),
        (dict[str, int], "Record<string, number>"),
        (list[scene_messages.ClipData | scene_messages.MotionData], "(ClipData | MotionData)[]"),
        (scene_messages.ArrayRef, "ArrayRef"),
    ],
)
def test_annotations_have_a_typescript_spelling(annotation: object, spelling: str) -> None:
    assert typescript_type(annotation) == spelling


def test_an_annotation_without_a_twin_is_refused() -> None:
    with pytest.raises(TypeError, match="no TypeScript type"):
        typescript_type(complex)


@given(st.lists(st.integers(0, 40), max_size=5), st.text(max_size=30))
def test_a_container_gives_back_what_was_packed_and_aligns_it(sizes: list[int], text: str) -> None:
    body = Body()
    arrays = [np.arange(n, dtype=np.float32) + n for n in sizes]
    refs = [body.add(a, "float32") for a in arrays]
    data = pack({"text": text, "refs": [[r.offset, r.bytes] for r in refs]}, body)
    header, rest = unpack(data)
    assert header["text"] == text
    assert (len(data) - len(rest)) % 8 == 0
    for values, (offset, size) in zip(arrays, header["refs"], strict=True):
        assert offset % 8 == 0
        assert np.array_equal(np.frombuffer(array(rest, {"offset": offset, "bytes": size}), "<f4"), values)


@pytest.mark.parametrize(
    ("data", "place"),
    [
        (b"", "byte 0"),
        (b"KPS2\0\0\0\0", "byte 0"),
        (b"KPS1\xff\xff\xff\xff{}", "byte 4"),
        (b"KPS1\x08\0\0\0not json", "byte 8"),
        (b"KPS1\x08\0\0\0[1,2]   ", "byte 8"),
        (b"KPS1\x10\x27\0\0" + b"[" * 10000, "byte 8"),
    ],
)
def test_a_damaged_container_is_refused_by_place(data: bytes, place: str) -> None:
    with pytest.raises(FormatError) as error:
        unpack(data)
    assert error.value.where == place


@pytest.mark.parametrize(
    "ref", [{}, {"offset": -8, "bytes": 8}, {"offset": 0, "bytes": 17}, {"offset": 1e9, "bytes": 1}]
)
def test_an_array_outside_the_body_is_refused(ref: dict[str, int]) -> None:
    with pytest.raises(FormatError, match="outside the body"):
        array(memoryview(bytes(16)), ref)


def test_numbers_that_json_does_not_know_never_leave() -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        pack({"x": float("nan")})
    assert json.loads(json.dumps(unpack(pack({"x": 1.5}))[0])) == {"x": 1.5}
