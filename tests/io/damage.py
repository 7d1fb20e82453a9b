"""Damaged files from sound ones, the same for the same seed, and a child process that loads them under watch."""

from __future__ import annotations

import json
import random
import re
import struct
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_INTEGER = re.compile(rb"(?<![\d.eE-])\d{1,6}(?![\d.])")
_ABSURD = (b"-1", b"0", b"2147483648", b"4294967295", b"99999999999999999999", b"1e308", b"1e999", b"-1e30")
_WORDS = (
    b"nan",
    b"NaN",
    b"inf",
    b"-Infinity",
    b"null",
    b"",
    b"--5",
    b"1.2.3",
    b"0x10",
    b"1,5",
    b"1_0",
    b"\x00",
    b"{",
    b"}",
)


def damaged(data: bytes, seed: int) -> bytes:
    """The bytes with one to three kinds of damage.

    Text is damaged as text: numbers replaced by absurd or impossible ones or exchanged (in a format that refers by
    number this makes cycles and self-parenting), lines deleted, doubled and swapped, brackets nested 100,000 deep. Any
    file may be cut, and have bytes flipped, inserted and removed. A GLB is damaged in its JSON half the time, and its
    lengths are then made to agree, so that the damage is not noticed at the door.
    """
    dice = random.Random(seed)
    if data[:4] == b"glTF" and len(data) > 20 and dice.random() < 0.6:
        (length,) = struct.unpack_from("<I", data, 12)
        text = _several(data[20 : 20 + length], dice, _TEXT)
        text += b" " * (-len(text) % 4)
        rest = data[20 + length :]
        return struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A) + text + rest
    kinds = _TEXT if b"\0" not in data[:512] else _BINARY
    return _several(data, dice, kinds)


def _several(data: bytes, dice: random.Random, kinds: Sequence[Callable[[bytes, random.Random], bytes]]) -> bytes:
    for _ in range(dice.choice((1, 1, 1, 2, 3))):
        data = dice.choice(kinds)(data, dice)
    return data


def _cut(data: bytes, dice: random.Random) -> bytes:
    return data[: dice.randrange(len(data) + 1)]


def _flip(data: bytes, dice: random.Random) -> bytes:
    changed = bytearray(data)
    for _ in range(dice.choice((1, 1, 3, 20))):
        if changed:
            changed[dice.randrange(len(changed))] ^= 1 << dice.randrange(8)
    return bytes(changed)


def _insert(data: bytes, dice: random.Random) -> bytes:
    at = dice.randrange(len(data) + 1)
    return data[:at] + dice.randbytes(dice.choice((1, 4, 300))) + data[at:]


def _remove(data: bytes, dice: random.Random) -> bytes:
    at = dice.randrange(len(data) + 1)
    return data[:at] + data[at + dice.choice((1, 4, 300)) :]


def _repeat(data: bytes, dice: random.Random) -> bytes:
    at = dice.randrange(len(data) + 1)
    return data[:at] + data[max(0, at - dice.choice((4, 300, 5000))) :]


def _zero(data: bytes, dice: random.Random) -> bytes:
    at = dice.randrange(len(data) + 1)
    size = min(dice.choice((4, 64, 4096)), len(data) - at)
    return data[:at] + b"\0" * size + data[at + size :]


def _overwrite_word(data: bytes, dice: random.Random) -> bytes:
    """A 32-bit count or offset, more often near the start where they live."""
    if len(data) < 8:
        return data
    at = min(int(len(data) * dice.random() ** 3), len(data) - 4) // 4 * 4
    return data[:at] + struct.pack("<I", dice.choice((0, 1, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF))) + data[at + 4 :]


def _replace_match(pattern: re.Pattern[bytes], data: bytes, dice: random.Random, by: bytes) -> bytes:
    # look near a random place; half the time near the start, where counts and the structure are
    at = dice.randrange(len(data) + 1) if dice.random() < 0.5 else dice.randrange(min(len(data), 3000) + 1)
    match = pattern.search(data, at) or pattern.search(data)
    return data[: match.start()] + by + data[match.end() :] if match else data


def _absurd_number(data: bytes, dice: random.Random) -> bytes:
    return _replace_match(_NUMBER, data, dice, dice.choice(_ABSURD))


def _no_number(data: bytes, dice: random.Random) -> bytes:
    return _replace_match(_NUMBER, data, dice, dice.choice(_WORDS))


def _small_integer(data: bytes, dice: random.Random) -> bytes:
    """Another index: of a parent, a child, a buffer."""
    return _replace_match(_INTEGER, data, dice, str(dice.choice((0, 0, 1, 2, 3, 5, 9, 70, 1000))).encode())


def _absurd_count(data: bytes, dice: random.Random) -> bytes:
    """The number behind a word that announces one."""
    pattern = re.compile(rb'(?<=(?:Frames: |HANNELS |"count":))\s*\d+')
    return _replace_match(pattern, data, dice, dice.choice((b"0", b"-3", b"1000000000", b"99999999999999999999", b"7")))


def _swap_words(data: bytes, dice: random.Random) -> bytes:
    words = list(re.finditer(rb"[^\s,]+", data[:200_000]))
    if len(words) < 2:
        return data
    a, b = sorted(dice.sample(range(len(words)), 2))
    a, b = words[a], words[b]
    return data[: a.start()] + b[0] + data[a.end() : b.start()] + a[0] + data[b.end() :]


def _edit_lines(data: bytes, dice: random.Random) -> bytes:
    lines = data.split(b"\n")
    # the first lines hold the structure; later ones are much alike
    a = dice.randrange(len(lines)) if dice.random() < 0.5 else dice.randrange(min(len(lines), 60))
    b = dice.randrange(len(lines))
    kind = dice.randrange(3)
    if kind == 0:
        del lines[a]
    elif kind == 1:
        lines.insert(a, lines[a])
    else:
        lines[a], lines[b] = lines[b], lines[a]
    return b"\n".join(lines)


def _nest(data: bytes, dice: random.Random) -> bytes:
    at = max(data.find(dice.choice((b"{", b"[", b"\n"))), 0)
    if b"HIERARCHY" in data[:100] and dice.random() < 0.7:
        joint = b"JOINT a\n{\nOFFSET 0 0 0\nCHANNELS 0\n"
        return data[:at] + b"\n" + joint * 100_000 + data[at:]
    return data[:at] + dice.choice((b"{", b"[", b'{"a":', b"}")) * 100_000 + data[at:]


_TEXT = (
    _cut, _flip, _insert, _remove, _repeat, _zero, _absurd_number, _absurd_number, _no_number, _no_number,
    _small_integer, _small_integer, _absurd_count, _swap_words, _swap_words, _edit_lines, _edit_lines, _edit_lines, _nest,
)  # fmt: skip
_BINARY = (_cut, _flip, _insert, _remove, _repeat, _zero, _overwrite_word, _overwrite_word)


def load_damaged(files: Sequence[Path], count: int, folder: Path, first_seed: int = 0) -> dict[str, object]:
    """Load ``count`` damaged copies of the files in a child process; what happened.

    Keys: ``loaded`` and ``refused`` counts, ``wrong`` (seed, file and message of every other outcome), ``slowest_s``
    with ``slowest``, and ``peak_mib`` of the child's resident memory.
    """
    command = [sys.executable, __file__, str(folder), str(first_seed), str(count), *map(str, files)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=900, check=False)
    if run.returncode != 0:
        raise AssertionError(f"the child that loads damaged files died ({run.returncode}):\n{run.stderr[-4000:]}")
    return json.loads(run.stdout.splitlines()[-1])


def _child(folder: Path, first_seed: int, count: int, files: Sequence[Path]) -> dict[str, object]:
    import resource
    import signal
    import time
    import warnings

    import numpy as np

    import keypose.io
    from keypose.errors import FormatError

    resource.setrlimit(resource.RLIMIT_DATA, (3 << 30, 3 << 30))
    warnings.simplefilter("error")  # a silent overflow or a NaN on the way is a wrong outcome too

    def hang(*_: object) -> None:
        raise TimeoutError("more than 10 s")

    # Seconds of this process: what else the machine does is not the reader's fault; one that waits is caught later.
    signal.signal(signal.SIGPROF, hang)
    signal.signal(signal.SIGALRM, hang)
    sound = [(path, path.read_bytes()) for path in files]
    result = {"loaded": 0, "refused": 0, "wrong": [], "slowest_s": 0.0, "slowest": ""}
    for seed in range(first_seed, first_seed + count):
        path, data = sound[seed % len(sound)]
        target = folder / f"damaged{path.suffix}"
        target.write_bytes(damaged(data, seed))
        signal.setitimer(signal.ITIMER_PROF, 10)
        signal.alarm(120)
        start = time.process_time()
        try:
            scene = keypose.io.load(target)
            outcome = "loaded"
        except FormatError as error:
            outcome = "refused"
            message = str(error)
            if "\n" in message or str(target) not in message or len(message) > 600:
                result["wrong"].append(f"seed {seed}, {path.name}: not one clear line: {message[:300]!r}")
        except BaseException as error:
            outcome = ""
            result["wrong"].append(f"seed {seed}, {path.name}: {type(error).__name__}: {str(error)[:200]}")
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.alarm(0)
        elapsed = time.process_time() - start
        if elapsed > result["slowest_s"]:
            result["slowest_s"], result["slowest"] = elapsed, f"seed {seed}, {path.name}"
        if outcome:
            result[outcome] += 1
        if outcome == "loaded":
            wrong = _unsound(scene, np)
            if wrong:
                result["wrong"].append(f"seed {seed}, {path.name}: loaded, but {wrong}")
    result["peak_mib"] = peak_mib()
    return result


def peak_mib() -> float:
    """Largest resident memory of this process; what getrusage says is also that of the process that started it."""
    import resource

    status = Path("/proc/self/status")
    if status.exists():
        return int(re.search(r"VmHWM:\s+(\d+)", status.read_text())[1]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _unsound(scene: object, np: object) -> str:
    """What is wrong with a scene that was loaded; the types' own checks hold already."""
    for character in scene.characters:
        rest = character.skeleton.rest
        if not (np.isfinite(rest.translations).all() and np.isfinite(rest.rotations).all()):
            return "the rest pose is not finite"
    for motion in scene.animations:
        pose = getattr(motion, "pose", None)
        if pose is None:
            continue
        if not (np.isfinite(pose.translations).all() and np.isfinite(pose.scales).all()):
            return "translations or scales are not finite"
        if not np.allclose(np.linalg.norm(pose.rotations, axis=-1), 1, atol=1e-6):
            return "rotations are not unit quaternions"
    return ""


if __name__ == "__main__":
    print(json.dumps(_child(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), [Path(p) for p in sys.argv[4:]])))
