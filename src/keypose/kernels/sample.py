# pyright: basic
"""Animation of many characters: sample their clips, blend, and walk the hierarchy.

Sampling has *joints* in the lanes, for the rows of a clip are contiguous; the hierarchy of a crowd has *characters* in
the lanes, for then nothing is gathered. A register transpose of W characters, a group of W joints at a time, joins
the two, and only the matrices leave the first-level cache. One character alone has joints in the lanes all the way:
it walks the hierarchy a depth at a time.

Clips are interpolated component by component and brought back to length 1 (nlerp), then summed with their weights, each
on the side of the sum so far.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from keypose.errors import ShapeError
from keypose.kernels.clips import (
    FRAMES,
    GROUP,
    INT16_SCALE,
    JOINTS,
    MOVING,
    MOVING_AT,
    ORDER,
    PADDED,
    PARENTS,
    REST,
    ROTATIONS,
    TRANSLATIONS,
    WAVE_PARENTS,
    WAVE_TABLE,
    WAVES,
    CompiledClips,
    Mix,
    compile_clips,
    mix,
)
from keypose.kernels.rotations import (
    load3,
    load4,
    quat_dot,
    quat_matrix,
    quat_multiply,
    quat_rotate,
    store3,
    store4,
)
from keypose.kernels.runtime import WIDTH, aligned, entry_of_address, inlined, kernel, scratch, short_kernel
from keypose.kernels.slerp import slerp, slerp_lanes
from keypose.kernels.vectors import (
    flip_sign,
    float32_at,
    int16_at,
    int32_at,
    int64_at,
    load,
    load_indices,
    load_numbers,
    permute,
    pointer,
    rsqrt,
    splat,
    store,
    transpose,
)

__all__ = [
    "CompiledClips", "Mix", "animate_crowd", "animate_one", "compile_clips", "mix", "sample", "sample_rows", "single_call", "single_character", "slerp", "slerp_lanes",
]  # fmt: skip

_ROWS = 7  # w x y z, translation
_UNIT = np.array([1, 0], np.float32)
_FLOAT32 = np.dtype(np.float32)


# --- Python-level entries -------------------------------------------------------------------------------------------------


def animate_crowd(clips: CompiledClips, state: Mix, out: np.ndarray | None = None) -> np.ndarray:
    """Model matrices of a crowd, in blocks of W characters, which is what `skincrowd.skin_crowd` reads.

    Returns (blocks, J, 12, W) float32: the rows of 3x4 matrices, characters in the lanes; in ``out`` if given. Where n is
    no multiple of W, the last character fills up its block.
    """
    shape = (-(-len(state.frames) // WIDTH), clips.joint_count, 12, WIDTH)
    out = aligned(int(np.prod(shape))).reshape(shape) if out is None else out
    _check_out(out, shape)
    if not _animate_blocks(clips.rotations, clips.scale, clips.handles, state.frames, state.shares, out):
        _refuse(clips, state)
    return out


def animate_one(clips: CompiledClips, state: Mix, out: np.ndarray | None = None) -> np.ndarray:
    """Model matrices (J, 4, 4) float32 of the first character of a mix; in ``out`` if given.

    The same clips, mix and ``out`` again, with new numbers in the mix, need no second look.
    """
    known = state.last[0]
    if known[0] is not clips or known[1] is not out:
        known = _single_call(clips, state, out)
    if not known[2](known[3]):
        _refuse(clips, state)
    return known[1]


def sample(clips: CompiledClips, state: Mix) -> tuple[np.ndarray, np.ndarray]:
    """Blended local poses: rotations (n, J, 4) and translations (n, J, 3), float32."""
    characters, joints = len(state.frames), clips.joint_count
    poses = aligned(characters * _ROWS * clips.padded).reshape(characters, _ROWS, clips.padded)
    poses[:, 4:] = clips.rest.reshape(3, clips.padded)
    if characters and not _sample_poses(clips.rotations, clips.scale, clips.handles, state.frames, state.shares, poses):
        _refuse(clips, state)
    sorted_back = np.empty((characters, _ROWS, joints), np.float32)
    sorted_back[:, :, clips.order] = poses[:, :, :joints]
    rows = sorted_back.transpose(0, 2, 1)
    return np.ascontiguousarray(rows[..., :4]), np.ascontiguousarray(rows[..., 4:])


def sample_rows(clips: CompiledClips, state: Mix, out: np.ndarray) -> None:
    """As `sample`, left in the layout of the kernels: character c writes rows of joints to ``out[c % len(out)]``.

    Shapes: out (slots, 7, padded) float32; joints in the order of ``clips.order``. Translations that never move are not
    written; they are ``clips.rest``.
    """
    _check_out(out, (len(out), _ROWS, clips.padded))
    if not _sample_poses(clips.rotations, clips.scale, clips.handles, state.frames, state.shares, out):
        _refuse(clips, state)


def _single_call(clips: CompiledClips, state: Mix, out: np.ndarray | None) -> tuple[Any, ...]:
    """The clips, the output, what to run on which address, and what is there."""
    shape = (clips.joint_count, 4, 4)
    given, out = out, aligned(clips.joint_count * 16).reshape(shape) if out is None else out
    _check_out(out, shape)
    if not state.frames.size:
        _refuse(clips, state)
    run = entry_of_address(single_character if clips.rotations.dtype == _FLOAT32 else single_character_int16)
    call = single_call(clips, state, out)
    known = (clips, out, run, call.ctypes.data, call)
    if given is not None:
        state.last[0] = known
    return known


def single_call(clips: CompiledClips, state: Mix, out: np.ndarray) -> np.ndarray:
    """What `single_character` takes the address of."""
    addresses = (a.ctypes.data for a in (clips.handles, state.frames, state.shares, out))
    return np.array([*addresses, state.frames.shape[1]], np.int64)


def _check_out(out: np.ndarray, shape: tuple[int, ...]) -> None:
    if out.shape != shape or out.dtype != _FLOAT32 or not out.flags.c_contiguous:
        raise ShapeError(f"out: expected {shape} of float32, got {out.shape} of {out.dtype}")


def _refuse(clips: CompiledClips, state: Mix) -> None:
    if not state.frames.size:
        raise ShapeError("mix: expected at least one character")
    low, high = state.frames.min(), state.frames.max()
    raise ShapeError(f"mix: expected frames 0 to {clips.frame_count - 1}, got {low} to {high}")


# --- sampling: joints in the lanes ----------------------------------------------------------------------------------------


@inlined
def _between(keys, a, b, stride, t):
    """Four rows, on the way from frame a to frame b."""
    w, x = load_numbers(keys, a), load_numbers(keys, a + stride)
    y, z = load_numbers(keys, a + 2 * stride), load_numbers(keys, a + 3 * stride)
    return (
        w + t * (load_numbers(keys, b) - w),
        x + t * (load_numbers(keys, b + stride) - x),
        y + t * (load_numbers(keys, b + 2 * stride) - y),
        z + t * (load_numbers(keys, b + 3 * stride) - z),
    )


@inlined
def _length_factor(w, x, y, z, linear, square):
    """1 / length by the series about length 1, for which no square root is needed.

    Neighbouring frames 30 degrees apart shorten a quaternion to 0.991; the error is below 2e-6 even there. ``linear``
    and ``square`` hold the scale that integers still have.
    """
    n = quat_dot(w, x, y, z, w, x, y, z)
    return 1.875 + n * (square * n - linear)


@inlined
def _sample_rotations(keys, padded, frames, shares, first, count, j, linear, square):
    """Rotations of one character, W joints from j on, blended over its clips."""
    a, b = np.intp(frames[first]) * 4 * padded + j, np.intp(frames[first + 1]) * 4 * padded + j
    w, x, y, z = _between(keys, a, b, padded, splat(shares, first))
    r = splat(shares, first + 1) * _length_factor(w, x, y, z, linear, square)
    sw, sx, sy, sz = w * r, x * r, y * r, z * r
    for k in range(first + 2, first + 2 * count, 2):
        a, b = np.intp(frames[k]) * 4 * padded + j, np.intp(frames[k + 1]) * 4 * padded + j
        w, x, y, z = _between(keys, a, b, padded, splat(shares, k))
        r = splat(shares, k + 1) * _length_factor(w, x, y, z, linear, square)
        r = flip_sign(r, quat_dot(w, x, y, z, sw, sx, sy, sz))
        sw, sx, sy, sz = sw + w * r, sx + x * r, sy + y * r, sz + z * r
    r = rsqrt(quat_dot(sw, sx, sy, sz, sw, sx, sy, sz))
    return sw * r, sx * r, sy * r, sz * r


@inlined
def _sample_translations(keys, moving, frames, shares, first, count, at):
    """Translations of one character, W joints, weighted sums over its clips."""
    a, b = np.intp(frames[first]) * 3 * moving + at, np.intp(frames[first + 1]) * 3 * moving + at
    t, weight = splat(shares, first), splat(shares, first + 1)
    x, y, z = load3(keys, a, moving)
    x1, y1, z1 = load3(keys, b, moving)
    x, y, z = weight * (x + t * (x1 - x)), weight * (y + t * (y1 - y)), weight * (z + t * (z1 - z))
    for k in range(first + 2, first + 2 * count, 2):
        a, b = np.intp(frames[k]) * 3 * moving + at, np.intp(frames[k + 1]) * 3 * moving + at
        t, weight = splat(shares, k), splat(shares, k + 1)
        x0, y0, z0 = load3(keys, a, moving)
        x1, y1, z1 = load3(keys, b, moving)
        x, y = x + weight * (x0 + t * (x1 - x0)), y + weight * (y0 + t * (y1 - y0))
        z = z + weight * (z0 + t * (z1 - z0))
    return x, y, z


@inlined
def _series(scale):
    unit = 1.0 / (scale * scale)
    return np.float32(1.25 * unit), np.float32(0.375 * unit * unit)


@inlined
def _outside(frames, count, limit):
    """Whether one of the frame numbers does not exist."""
    wrong = False
    for k in range(count):
        wrong |= np.uint32(frames[k]) >= np.uint32(limit)
    return wrong


@kernel
def _sample_pose(
    keys, moves, moving_at, padded, moving, linear, square, frames, shares, first, count, out, at, stride
):  # fmt: skip
    """Rows of the joints of one character, ``stride`` apart; translations that never move are left as they are."""
    for j in range(0, padded, WIDTH):
        w, x, y, z = _sample_rotations(keys, padded, frames, shares, first, count, j, linear, square)
        store4(out, at + j, stride, w, x, y, z)
        group = moving_at[j // GROUP]
        if group >= 0:
            x, y, z = _sample_translations(moves, moving, frames, shares, first, count, group + j % GROUP)
            store3(out, at + 4 * stride + j, stride, x, y, z)


@kernel
def _sample_poses(rotations, scale, handles, frames, shares, out):
    """Poses [slot][7][padded]; character c writes slot c % slots. False if a frame does not exist."""
    characters, count, slots = frames.shape[0], frames.shape[1], out.shape[0]
    before, parts, poses, keys = pointer(frames), pointer(shares), pointer(out), pointer(rotations)
    if _outside(before, frames.size, handles[FRAMES]):
        return False
    linear, square = _series(scale)
    padded, moving = handles[PADDED], handles[MOVING]
    moves, places = float32_at(handles[TRANSLATIONS]), int64_at(handles[MOVING_AT])
    for c in range(characters):
        _sample_pose(
            keys, moves, places, padded, moving, linear, square, before, parts, c * 2 * count, count, poses,
            (c % slots) * _ROWS * padded, padded,
        )  # fmt: skip
    return True


# --- crowds: characters in the lanes --------------------------------------------------------------------------------------


@kernel
def _animate_blocks(rotations, scale, handles, frames, shares, out):
    """The whole chain for all characters. False if a frame does not exist."""
    characters, count, blocks = frames.shape[0], frames.shape[1], out.shape[0]
    joints, padded, moving = handles[JOINTS], handles[PADDED], handles[MOVING]
    before, parts, models, keys = pointer(frames), pointer(shares), pointer(out), pointer(rotations)
    if _outside(before, frames.size, handles[FRAMES]):
        return False
    linear, square = _series(scale)
    moves, still, places = float32_at(handles[TRANSLATIONS]), float32_at(handles[REST]), int64_at(handles[MOVING_AT])
    order, parents = int64_at(handles[ORDER]), int64_at(handles[PARENTS])
    memory = scratch(2 * _ROWS * WIDTH * WIDTH + padded * _ROWS * WIDTH)
    poses = pointer(memory)
    lanes_at, world = _ROWS * WIDTH * WIDTH, 2 * _ROWS * WIDTH * WIDTH
    for block in range(blocks):
        base = block * joints * 12 * WIDTH
        for j in range(0, joints, WIDTH):
            group = places[j // GROUP]
            for i in range(WIDTH):
                first, at = min(block * WIDTH + i, characters - 1) * 2 * count, i * _ROWS * WIDTH
                w, x, y, z = _sample_rotations(keys, padded, before, parts, first, count, j, linear, square)
                store4(poses, at, WIDTH, w, x, y, z)
                if group >= 0:
                    x, y, z = _sample_translations(moves, moving, before, parts, first, count, group + j % GROUP)
                    store3(poses, at + 4 * WIDTH, WIDTH, x, y, z)
            for row in range(_ROWS if group >= 0 else 4):
                transpose(poses, row * WIDTH, _ROWS * WIDTH, poses, lanes_at + row * WIDTH, _ROWS * WIDTH)
            for k in range(j, min(j + WIDTH, joints)):
                here, up = lanes_at + (k - j) * _ROWS * WIDTH, parents[k]
                w, x, y, z = load4(poses, here, WIDTH)
                if group >= 0:
                    tx, ty, tz = load3(poses, here + 4 * WIDTH, WIDTH)
                else:
                    tx, ty, tz = splat(still, k), splat(still, padded + k), splat(still, 2 * padded + k)
                if up >= 0:
                    above = world + up * _ROWS * WIDTH
                    pw, px, py, pz = load4(poses, above, WIDTH)
                    ox, oy, oz = load3(poses, above + 4 * WIDTH, WIDTH)
                    w, x, y, z = quat_multiply(pw, px, py, pz, w, x, y, z)
                    tx, ty, tz = quat_rotate(pw, px, py, pz, tx, ty, tz)
                    tx, ty, tz = tx + ox, ty + oy, tz + oz
                mine = world + k * _ROWS * WIDTH
                store4(poses, mine, WIDTH, w, x, y, z)
                store3(poses, mine + 4 * WIDTH, WIDTH, tx, ty, tz)
                a, b, c, d, e, f, g, h, i = quat_matrix(w, x, y, z)
                to = base + order[k] * 12 * WIDTH
                store4(models, to, WIDTH, a, b, c, tx)
                store4(models, to + 4 * WIDTH, WIDTH, d, e, f, ty)
                store4(models, to + 8 * WIDTH, WIDTH, g, h, i, tz)
    return True


# --- one character: joints in the lanes, a depth at a time ------------------------------------------------------------------


@short_kernel
def single_character(call):
    """The whole chain for the first character of float32 clips. False if a frame does not exist."""
    handles = int64_at(int64_at(call)[0])
    return _single(float32_at(handles[ROTATIONS]), 1.0, handles, int64_at(call))


@short_kernel
def single_character_int16(call):
    """As `single_character`, of int16 clips."""
    handles = int64_at(int64_at(call)[0])
    return _single(int16_at(handles[ROTATIONS]), INT16_SCALE, handles, int64_at(call))


@kernel
def _single(rotations, scale, handles, call):
    joints, padded, moving = handles[JOINTS], handles[PADDED], handles[MOVING]
    before, parts, models, count = int32_at(call[1]), float32_at(call[2]), float32_at(call[3]), call[4]
    if _outside(before, 2 * count, handles[FRAMES]):
        return False
    still, places, order = float32_at(handles[REST]), int64_at(handles[MOVING_AT]), int64_at(handles[ORDER])
    waves, wave_parents = int64_at(handles[WAVE_TABLE]), int32_at(handles[WAVE_PARENTS])
    stride = padded + WIDTH  # a wave reads and writes W places, also where fewer are its own
    memory = scratch(2 * _ROWS * stride + 16 * WIDTH + 16 * padded)
    pose = pointer(memory)
    world, rows = _ROWS * stride, 2 * _ROWS * stride
    tiles = rows + 16 * WIDTH
    for j in range(0, padded, WIDTH):
        if places[j // GROUP] < 0:
            x, y, z = load3(still, j, padded)
            store3(pose, 4 * stride + j, stride, x, y, z)
    linear, square = _series(scale)
    _sample_pose(
        rotations, float32_at(handles[TRANSLATIONS]), places, padded, moving, linear, square, before, parts, 0, count,
        pose, 0, stride,
    )  # fmt: skip
    # The wave before stays in registers: reading back what was just written, at another place, would wait for it.
    lw, lx, ly, lz = load4(pose, 0, stride)
    lu, lv, lt = load3(pose, 4 * stride, stride)
    last = -1
    for k in range(handles[WAVES]):
        here, up = waves[3 * k], waves[3 * k + 2]
        w, x, y, z = load4(pose, here, stride)
        tx, ty, tz = load3(pose, 4 * stride + here, stride)
        if up >= 0:
            if up != last:
                lw, lx, ly, lz = load4(pose, world + up, stride)
                lu, lv, lt = load3(pose, world + 4 * stride + up, stride)
            lane = load_indices(wave_parents, k * WIDTH)
            pw, px, py, pz = permute(lw, lane), permute(lx, lane), permute(ly, lane), permute(lz, lane)
            w, x, y, z = quat_multiply(pw, px, py, pz, w, x, y, z)
            tx, ty, tz = quat_rotate(pw, px, py, pz, tx, ty, tz)
            tx, ty, tz = tx + permute(lu, lane), ty + permute(lv, lane), tz + permute(lt, lane)
        store4(pose, world + here, stride, w, x, y, z)
        store3(pose, world + 4 * stride + here, stride, tx, ty, tz)
        lw, lx, ly, lz, lu, lv, lt, last = w, x, y, z, tx, ty, tz, here
    one, zero = splat(_UNIT, 0), splat(_UNIT, 1)
    for j in range(0, joints, WIDTH):
        w, x, y, z = load4(pose, world + j, stride)
        tx, ty, tz = load3(pose, world + 4 * stride + j, stride)
        a, b, c, d, e, f, g, h, i = quat_matrix(w, x, y, z)
        store4(pose, rows, WIDTH, a, b, c, tx)
        store4(pose, rows + 4 * WIDTH, WIDTH, d, e, f, ty)
        store4(pose, rows + 8 * WIDTH, WIDTH, g, h, i, tz)
        store4(pose, rows + 12 * WIDTH, WIDTH, zero, zero, zero, one)
        for first in range(0, 16, WIDTH):
            transpose(pose, rows + first * WIDTH, WIDTH, pose, tiles + first, 16)
        for k in range(j, min(j + WIDTH, joints)):
            for first in range(0, 16, WIDTH):
                store(models, order[k] * 16 + first, load(pose, tiles + (k - j) * 16 + first))
    return True
