# pyright: basic
"""Encoding one segment of a compiled clip: from parents to children, each joint making up for the errors above it.

A segment is 16 frames. The curve of one number over a segment (a *track*) is turned into 16 coefficients of the discrete
cosine transform and rounded in steps. A joint's local rotation is not the original one but the one that puts it where it
belongs *given the decoded parents*, so errors do not add up down the hierarchy; the error that remains is measured in
model space at points off every joint. Steps are widened until it reaches the tolerance.

Source: the method is ours; measuring in model space at virtual vertices follows N. Frechette, "Animation Compression
Library" (2017), and feeding the encoder the decoded parents is closed-loop (DPCM) coding, Jayant & Noll 1984, chapter 6.
"""

from __future__ import annotations

import math

import numpy as np

from keypose.kernels.runtime import inlined, kernel

FRAMES = 16
MAX_BITS = 24
COARSEST = 127
SCALE_STEPS = 8  # the scale of a segment is a power of 2 ** (1 / 8)


@inlined
def _multiply(a, b, out):
    aw, ax, ay, az, bw, bx, by, bz = a[0], a[1], a[2], a[3], b[0], b[1], b[2], b[3]
    out[0] = aw * bw - ax * bx - ay * by - az * bz
    out[1] = aw * bx + ax * bw + ay * bz - az * by
    out[2] = aw * by - ax * bz + ay * bw + az * bx
    out[3] = aw * bz + ax * by - ay * bx + az * bw


@inlined
def _conjugate(a, out):
    out[0], out[1], out[2], out[3] = a[0], -a[1], -a[2], -a[3]


@inlined
def _matrix(q, t, s, out):
    """T R S as twelve numbers, three rows of four."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    out[0], out[1], out[2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    out[4], out[5], out[6] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    out[8], out[9], out[10] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    for row in range(3):
        for column in range(3):
            out[4 * row + column] *= s[column]
        out[4 * row + 3] = t[row]


@inlined
def _chain(up, own, out):
    for row in range(3):
        a, b, c, d = up[4 * row], up[4 * row + 1], up[4 * row + 2], up[4 * row + 3]
        for column in range(4):
            out[4 * row + column] = a * own[column] + b * own[4 + column] + c * own[8 + column]
        out[4 * row + 3] += d


@kernel
def model_matrices(parents, rotations, translations, scales, world_rotations, matrices):
    """(F, J, ...) local transforms to model space: quaternions (true without scales) and 3x4 matrices (F, J, 12)."""
    own = np.empty(12)
    for f in range(rotations.shape[0]):
        for j in range(parents.shape[0]):
            p = parents[j]
            _matrix(rotations[f, j], translations[f, j], scales[f, j], own)
            if p < 0:
                matrices[f, j] = own
                world_rotations[f, j] = rotations[f, j]
            else:
                _chain(matrices[f, p], own, matrices[f, j])
                _multiply(world_rotations[f, p], rotations[f, j], world_rotations[f, j])


@kernel
def shell_errors(a, b, shell, out):
    """Largest distance (F, J) between two poses (F, J, 12) of the points ``shell`` metres off each joint on its axes."""
    for f in range(a.shape[0]):
        for j in range(a.shape[1]):
            worst = 0.0
            for axis in range(3):
                total = 0.0
                for row in range(3):
                    k = 4 * row
                    d = (a[f, j, k + 3] - b[f, j, k + 3]) + shell * (a[f, j, k + axis] - b[f, j, k + axis])
                    total += d * d
                worst = max(worst, total)
            out[f, j] = math.sqrt(worst)


@inlined
def _bits_of(magnitude):
    """Bits that hold a coefficient of this many steps: none up to half a step, else n with |c| <= 2 ** (n - 1)."""
    if magnitude <= 0.5:
        return 0
    bits, reach = 1, 1.0
    while magnitude > reach:
        bits, reach = bits + 1, 2 * reach
    return bits


@kernel
def _encode_track(values, step, basis, book, sizes, codes, needed, chosen):
    """Round one track (16,) in place to what the decoder will see; returns its bits, or -1 where it does not fit.

    ``needed`` (16,) gets the bits of each coefficient; with a ``book`` of profiles (sorted by size) the first one that is
    large enough is ``chosen``, and its zeros are the only ones.
    """
    coefficients = np.empty(FRAMES)
    for k in range(FRAMES):
        total = 0.0
        for f in range(FRAMES):
            total += basis[f, k] * values[f]
        coefficients[k] = total / step
        needed[k] = _bits_of(abs(coefficients[k]))
        if needed[k] > MAX_BITS:
            return -1
    size = 0
    profile = -1
    if book.shape[0] > 0:
        for p in range(book.shape[0]):
            fits = True
            for k in range(FRAMES):
                if needed[k] > book[p, k]:
                    fits = False
                    break
            if fits:
                profile = p
                break
        if profile < 0:
            return -1
        size = sizes[profile]
    else:
        for k in range(FRAMES):
            size += needed[k]
    chosen[0] = profile
    for k in range(FRAMES):
        bits = needed[k] if profile < 0 else book[profile, k]
        if bits == 0:
            codes[k] = 0
            coefficients[k] = 0.0
        else:
            half = np.int64(1) << (bits - 1)
            code = np.int64(math.floor(coefficients[k]))
            code = min(max(code, -half), half - 1)
            codes[k] = code
            coefficients[k] = (code + 0.5) * step
    for f in range(FRAMES):
        total = 0.0
        for k in range(FRAMES):
            total += basis[f, k] * coefficients[k]
        values[f] = total
    return size


@kernel
def _steady(anchor_error, offsets, count, leaf, turn):
    """The small rotation vector that best keeps a joint's children in place though the joint itself is off."""
    # Minimise sum |e + w x r|^2 + leaf |w|^2: (sum (|r|^2 I - r r^T) + leaf I) w = -sum r x e.
    m = np.zeros((3, 3))
    right = np.zeros(3)
    for k in range(3):
        m[k, k] = leaf
    for c in range(count):
        x, y, z = offsets[c, 0], offsets[c, 1], offsets[c, 2]
        square = x * x + y * y + z * z
        m[0, 0] += square - x * x
        m[1, 1] += square - y * y
        m[2, 2] += square - z * z
        m[0, 1] -= x * y
        m[0, 2] -= x * z
        m[1, 2] -= y * z
        right[0] -= y * anchor_error[2] - z * anchor_error[1]
        right[1] -= z * anchor_error[0] - x * anchor_error[2]
        right[2] -= x * anchor_error[1] - y * anchor_error[0]
    a, b, c, d, e, f = m[0, 0], m[0, 1], m[0, 2], m[1, 1], m[1, 2], m[2, 2]
    i0, i1, i2 = d * f - e * e, c * e - b * f, b * e - c * d
    determinant = a * i0 + b * i1 + c * i2
    turn[0] = (i0 * right[0] + i1 * right[1] + i2 * right[2]) / determinant
    turn[1] = (i1 * right[0] + (a * f - c * c) * right[1] + (b * c - a * e) * right[2]) / determinant
    turn[2] = (i2 * right[0] + (b * c - a * e) * right[1] + (a * d - b * b) * right[2]) / determinant


@kernel
def encode_segment(rig, truth, steps, scale, coder, limits, closed, out):
    """Encode the 16 frames of one segment; returns (largest error / tolerance, bits), infinity where it does not fit.

    rig: parents (J,); kinds (J,) 0 constant, 3 or 4 coded numbers of the rotation; pre, post (J, 4) the quaternions around
    them; base (J, 6) constant translation and scale; rotation_tracks (J, 4) tracks of w, x, y, z and other_tracks (J, 6)
    of translation and scale, -1 for none; child_starts (J + 1,) and children; weight_tracks (M,).
    truth: 16 frames of local rotations, translations, scales, model-space rotations and matrices, morph weights.
    coder: basis (16, 16), book (P, 16) or empty, sizes (P,). limits: tolerances (J,), of weights, distance of the shell.
    out: codes and needed (tracks, 16), chosen (tracks,), joint_ratio (J,).
    """
    parents, kinds, pre, post, base, rotation_tracks, other_tracks, child_starts, children, weight_tracks = rig
    rotations, translations, scales, true_rotations, true_matrices, weights = truth
    basis, book, sizes = coder
    tolerances, weight_tolerance, shell = limits
    codes, needed, chosen, joint_ratio = out
    joints = parents.shape[0]
    world = np.empty((FRAMES, joints, 4))
    matrices = np.empty((FRAMES, joints, 12))
    spin = np.empty((FRAMES, 4))
    values = np.empty((6, FRAMES))
    own, q, c, up, turned = np.empty(12), np.empty(4), np.empty(4), np.empty(4), np.empty(4)
    error, turn, offsets = np.empty(3), np.empty(3), np.empty((8, 3))
    t, s = np.empty(3), np.empty(3)
    bits = 0
    worst = 0.0
    for j in range(joints):
        p = parents[j]
        kind = kinds[j]
        # Translations first: they decide from where the rotation has to work.
        for k in range(6):
            track = other_tracks[j, k]
            if track < 0:
                for f in range(FRAMES):
                    values[k, f] = base[j, k]
                continue
            for f in range(FRAMES):
                if k < 3:
                    value = translations[f, j, k]
                    if closed and p >= 0:
                        value = 0.0
                        for row in range(3):  # the inverse of a rotation is its transpose
                            value += matrices[f, p, 4 * row + k] * (
                                true_matrices[f, j, 4 * row + 3] - matrices[f, p, 4 * row + 3]
                            )
                else:
                    value = scales[f, j, k - 3]
                values[k, f] = value - base[j, k]
            size = _encode_track(
                values[k],
                steps[track] * scale,
                basis,
                book,
                sizes,
                codes[track],
                needed[track],
                chosen[track : track + 1],
            )
            if size < 0:
                return math.inf, 0
            bits += size
            for f in range(FRAMES):
                values[k, f] += base[j, k]
        if kind > 0:
            first = child_starts[j]
            count = min(child_starts[j + 1] - first, 8)
            for f in range(FRAMES):
                if closed:
                    q[:] = true_rotations[f, j]
                    if count > 0:
                        for row in range(3):
                            place = values[row, f]
                            if p >= 0:
                                place = matrices[f, p, 4 * row + 3]
                                for column in range(3):
                                    place += matrices[f, p, 4 * row + column] * values[column, f]
                            error[row] = place - true_matrices[f, j, 4 * row + 3]
                        for n in range(count):
                            child = children[first + n]
                            for row in range(3):
                                offsets[n, row] = (
                                    true_matrices[f, child, 4 * row + 3] - true_matrices[f, j, 4 * row + 3]
                                )
                        _steady(error, offsets, count, 2 * shell * shell, turn)
                        c[0], c[1], c[2], c[3] = 1.0, turn[0] / 2, turn[1] / 2, turn[2] / 2
                        up[:] = q
                        _multiply(c, up, q)
                        length = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
                        for k in range(4):
                            q[k] /= length
                    if p >= 0:
                        _conjugate(world[f, p], up)
                        c[:] = q
                        _multiply(up, c, q)
                else:
                    q[:] = rotations[f, j]
                _conjugate(pre[j], up)
                _multiply(up, q, turned)
                _conjugate(post[j], up)
                _multiply(turned, up, c)
                # Stay on the side of the original, which is continuous.
                _conjugate(pre[j], up)
                _multiply(up, rotations[f, j], turned)
                _conjugate(post[j], up)
                _multiply(turned, up, q)
                sign = 1.0 if c[0] * q[0] + c[1] * q[1] + c[2] * q[2] + c[3] * q[3] >= 0 else -1.0
                below = 1.0
                if kind == 3:
                    below = 1.0 + sign * c[0]
                    if below < 0.1:
                        return math.inf, 0
                for k in range(4):
                    spin[f, k] = sign * c[k] / below
            for k in range(4):
                track = rotation_tracks[j, k]
                if track < 0:
                    spin[:, k] = 0.0
                    continue
                line = spin[:, k].copy()
                size = _encode_track(
                    line,
                    steps[track] * scale,
                    basis,
                    book,
                    sizes,
                    codes[track],
                    needed[track],
                    chosen[track : track + 1],
                )
                if size < 0:
                    return math.inf, 0
                bits += size
                spin[:, k] = line
        joint_ratio[j] = 0.0
        for f in range(FRAMES):
            if kind > 0:
                square = spin[f, 1] * spin[f, 1] + spin[f, 2] * spin[f, 2] + spin[f, 3] * spin[f, 3]
                w, double = spin[f, 0], 1.0
                if kind == 3:
                    w, double = 1.0 - square, 2.0
                length = math.sqrt(w * w + double * double * square)
                if length < 1e-6:
                    return math.inf, 0
                c[0] = w / length
                for k in range(1, 4):
                    c[k] = double * spin[f, k] / length
                _multiply(pre[j], c, turned)
                _multiply(turned, post[j], q)
            else:
                q[:] = pre[j]
            for k in range(3):
                t[k], s[k] = values[k, f], values[3 + k, f]
            _matrix(q, t, s, own)
            if p < 0:
                world[f, j] = q
                matrices[f, j] = own
            else:
                _multiply(world[f, p], q, world[f, j])
                _chain(matrices[f, p], own, matrices[f, j])
            for axis in range(3):
                total = 0.0
                for row in range(3):
                    k = 4 * row
                    d = matrices[f, j, k + 3] - true_matrices[f, j, k + 3]
                    d += shell * (matrices[f, j, k + axis] - true_matrices[f, j, k + axis])
                    total += d * d
                joint_ratio[j] = max(joint_ratio[j], math.sqrt(total) / tolerances[j])
        worst = max(worst, joint_ratio[j])
    for m in range(weight_tracks.shape[0]):
        track = weight_tracks[m]
        if track < 0:
            continue
        line = weights[:, m].copy()
        size = _encode_track(
            line, steps[track] * scale, basis, book, sizes, codes[track], needed[track], chosen[track : track + 1]
        )
        if size < 0:
            return math.inf, 0
        bits += size
        for f in range(FRAMES):
            worst = max(worst, abs(line[f] - weights[f, m]) / weight_tolerance)
    return worst, bits


@kernel
def search_scale(rig, truth, steps, hint, lowest, coder, limits, closed, goal, lucky, out):
    """The coarsest scale ``2 ** (n / 8)`` of a segment's steps whose error stays under ``goal`` tolerances.

    Starts at n = ``hint``, tries ``lucky`` coarser scales beyond the first failure, and leaves the outputs of
    `encode_segment` for the one it returns. Returns (n, error, bits); n = ``lowest`` is the last resort.
    """
    # Infinity says that the steps are too fine to be stored; then only coarser ones are left.
    good, bad = np.int64(lowest - 1), np.int64(COARSEST + 1)
    n, stride = np.int64(hint), np.int64(4)
    while bad - good > 1:
        ratio, bits = encode_segment(rig, truth, steps, 2.0 ** (n / SCALE_STEPS), coder, limits, closed, out)
        if ratio <= goal or ratio == math.inf:
            good = n
        else:
            bad = n
        if bad > COARSEST:
            n = min(good + stride, COARSEST)
            stride *= 2
        elif good < lowest:
            n = max(bad - stride, lowest)
            stride *= 2
        else:
            n = (good + bad) // 2
    # Errors are noisy: a coarser scale may pass by luck.
    best = max(good, lowest)
    n = min(best + 1 + lucky, COARSEST)
    while True:
        ratio, bits = encode_segment(rig, truth, steps, 2.0 ** (n / SCALE_STEPS), coder, limits, closed, out)
        if ratio <= goal or n <= best:
            break
        n -= 1
    while ratio == math.inf and n < COARSEST:
        n += 1
        ratio, bits = encode_segment(rig, truth, steps, 2.0 ** (n / SCALE_STEPS), coder, limits, closed, out)
    return n, ratio, bits


@kernel
def cheapest_profiles(vectors, profiles, sizes, out):
    """The smallest of ``profiles`` (sorted by size) that holds each of ``vectors`` (N, 16); returns all their bits."""
    total = np.int64(0)
    for i in range(vectors.shape[0]):
        out[i] = -1
        for p in range(profiles.shape[0]):
            fits = True
            for k in range(vectors.shape[1]):
                if vectors[i, k] > profiles[p, k]:
                    fits = False
                    break
            if fits:
                out[i] = p
                total += sizes[p]
                break
    return total


@inlined
def _merge_cost(profiles, counts, i, j):
    cost = 0.0
    for k in range(profiles.shape[1]):
        m = max(profiles[i, k], profiles[j, k])
        cost += counts[i] * (m - profiles[i, k]) + counts[j] * (m - profiles[j, k])
    return cost


@kernel
def merge_profiles(profiles, counts, most, price):
    """Unite profiles (N, 16), each time the two that cost fewest bits, until ``most`` are left and another costs ``price``.

    Works in place; returns which rows are left.
    """
    n = profiles.shape[0]
    alive = np.ones(n, np.bool_)
    nearest = np.zeros(n, np.int64)
    distance = np.full(n, np.inf)
    for i in range(n):
        for j in range(n):
            if i != j:
                cost = _merge_cost(profiles, counts, i, j)
                if cost < distance[i]:
                    distance[i], nearest[i] = cost, j
    left = n
    while left > 1:
        a = -1
        for i in range(n):
            if alive[i] and (a < 0 or distance[i] < distance[a]):
                a = i
        if left <= most and distance[a] > price:
            break
        b = nearest[a]
        for k in range(profiles.shape[1]):
            profiles[a, k] = max(profiles[a, k], profiles[b, k])
        counts[a] += counts[b]
        alive[b] = False
        left -= 1
        for i in range(n):
            if not alive[i]:
                continue
            if i == a or nearest[i] == a or nearest[i] == b:
                distance[i] = np.inf
                for j in range(n):
                    if j != i and alive[j]:
                        cost = _merge_cost(profiles, counts, i, j)
                        if cost < distance[i]:
                            distance[i], nearest[i] = cost, j
            else:
                cost = _merge_cost(profiles, counts, i, a)
                if cost < distance[i]:
                    distance[i], nearest[i] = cost, a
    return alive
