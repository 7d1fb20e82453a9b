# pyright: basic
"""Curves by the thousand, each with its own keys, at one or many times; and the fewest keys for what moves.

A *track* is one curve. Keys of all tracks stand one after another; `tracks` holds a row of numbers for each:

    first key, number of keys, first value, components, first tangent, first handle, kind, before, after, mode (-1: several)

Values are (keys, components) from their first on, tangents (keys, [in, out], components) and handles (keys, [in, out],
components, 2), so that what a span needs stands together. Results are written track by track, component by component,
(components, times), so that neighbouring times stand side by side.
"""

from __future__ import annotations

import math

import numpy as np

from keypose.kernels.runtime import inlined, kernel

KEY, KEYS, VALUE, WIDTH, TANGENT, HANDLE, KIND, BEFORE, AFTER, MODE = range(10)
LINES, NUMBERS, ROTATION = range(3)  # kinds: straight everywhere, numbers of any mode, unit quaternions
HOLD, GO_ON, CYCLE, CYCLE_OFFSET, PING_PONG = range(5)
_STEP, _LINEAR, _HERMITE = 0, 1, 2
_NEWTON = 40


@inlined
def _span_of(keys, low, count, time):
    """The last key at or before a time that lies within the keys; from a guess as if they were even, then by halves."""
    last = low + count - 1
    if time >= keys[last]:
        return last
    share = (time - keys[low]) / (keys[last] - keys[low])
    at = low + min(max(int(share * (count - 1)), 0), count - 2)
    a, b = low, last
    if keys[at] <= time:
        a = at
        step = 1
        while a + step < last and keys[a + step] <= time:
            a += step
            step *= 2
        b = min(a + step, last)
    else:
        b = at
        step = 1
        while b - step > low and keys[b - step] > time:
            b -= step
            step *= 2
        a = max(b - step, low)
    while b - a > 1:
        middle = (a + b) // 2
        if keys[middle] <= time:
            a = middle
        else:
            b = middle
    return a


@inlined
def _parameter(a, b, x):
    """u where the cubic of 0, a, b, 1 reaches x; as `keypose.math.spline.bezier_parameter`."""
    far = x > (3 * a + 3 * b + 1) / 8
    if far:
        a, b, x = 1 - b, 1 - a, 1 - x
    u = 0.0
    if x > 0:
        c1, c2, c3 = 3 * a, 3 * (b - 2 * a), 1 - 3 * b + 3 * a
        linear = x / a if a > 1e-30 else 1e30
        square = math.sqrt(x / b) if b > 1e-30 else 1e15
        third = x ** (1 / 3)
        low = 0.999 * min(linear / 9, square / 3, third * 0.69)
        high = min(linear / 0.75, square * 0.82, third * 1.001, 0.5)
        low = min(low, high)
        u = low
        for _ in range(_NEWTON):
            error = ((c3 * u + c2) * u + c1) * u - x
            if error > 0:
                high = u
            else:
                low = u
            slope = (3 * c3 * u + 2 * c2) * u + c1
            after = u - error / slope if slope > 0 else -1.0
            if not low <= after <= high:
                after = 0.5 * (low + high)
            if abs(after - u) <= 4e-16 * u:
                u = after
                break
            u = after
    return 1 - u if far else u


@inlined
def _bezier(v0, dt0, dv0, v1, dt1, dv1, span, share):
    """One component of a Bezier span; handles longer than the span are shortened to it."""
    dt1, dv1 = -dt1, -dv1
    if dt0 > span:
        dt0, dv0 = span, dv0 * (span / dt0)
    if dt1 > span:
        dt1, dv1 = span, dv1 * (span / dt1)
    u = _parameter(dt0 / span, 1 - dt1 / span, share)
    v, d = 1 - u, v1 - v0
    bend = 3 * u * v * (v * dv0 - u * dv1)
    return bend + (v0 + u * u * (3 - 2 * u) * d if u < 0.5 else v1 - v * v * (3 - 2 * v) * d)


@inlined
def _hermite(p0, m0, p1, m1, u, span):
    v, d = 1 - u, p1 - p0
    bend = span * (u * v) * (v * m0 - u * m1)
    return bend + (p0 + u * u * (3 - 2 * u) * d if u < 0.5 else p1 - v * v * (3 - 2 * v) * d)


@kernel
def _lines(times, tracks, n, keys, modes, values, spans, shares, out, row):
    """A track of lines and steps at times between its first and its last key: first all places, then all values."""
    low, total, width, start = tracks[n, KEY], tracks[n, KEYS], tracks[n, WIDTH], tracks[n, VALUE]
    first, last = keys[low], low + total - 2
    count = times.shape[0]
    kind = values.dtype.type
    one, half = kind(1), kind(0.5)
    if tracks[n, MODE] == _LINEAR and count < total:
        # Frames of one rate, as captures have them: every time lies in the span after the one before.
        k = min(_span_of(keys, low, total, times[0]), last)
        if k + count - 1 <= last:
            here, after = keys[k : k + count], keys[k + 1 : k + 1 + count]
            # A pass for each question, or none of them goes in vectors; the quotient of two differences that were taken in full
            # precision is made in that of the values, where a division takes a quarter of the time.
            strays = 0
            for t in range(count):
                strays += (here[t] > times[t]) | (after[t] <= times[t])
            if strays == 0:
                for t in range(count):
                    shares[t] = kind(times[t] - here[t]) / kind(after[t] - here[t])
                at = start + (k - low) * width
                own = values[at : at + (count + 1) * width]
                if width == 3:
                    x, y, z = out[row], out[row + 1], out[row + 2]
                    for t in range(count):
                        share, p, q = shares[t], 3 * t, 3 * t + 3
                        d, e, f = own[q] - own[p], own[q + 1] - own[p + 1], own[q + 2] - own[p + 2]
                        near, left = share < half, one - share
                        x[t] = own[p] + share * d if near else own[q] - left * d
                        y[t] = own[p + 1] + share * e if near else own[q + 1] - left * e
                        z[t] = own[p + 2] + share * f if near else own[q + 2] - left * f
                    return
                for c in range(width):
                    for t in range(count):
                        a, b = own[t * width + c], own[(t + 1) * width + c]
                        rise, share = b - a, shares[t]
                        out[row + c, t] = a + share * rise if share < half else b - (one - share) * rise
                return
    scale = (total - 1) / (keys[low + total - 1] - first)
    strays = 0
    for t in range(times.shape[0]):  # as if keys were even
        k = low + np.int64((times[t] - first) * scale)
        k = min(k, last)
        here, after = keys[k], keys[k + 1]
        strays += (here > times[t]) | ((after <= times[t]) & (k < last))
        spans[t] = k
        shares[t] = (times[t] - here) / (after - here)
    if strays > 0:
        k = low
        for t in range(times.shape[0]):
            time = times[t]
            steps = 0
            while k < last and keys[k + 1] <= time:
                k += 1
                steps += 1
                if steps == 8:
                    k = min(_span_of(keys, low, total, time), last)
            spans[t] = k
            shares[t] = (time - keys[k]) / (keys[k + 1] - keys[k])
    if tracks[n, MODE] != _LINEAR:
        for t in range(times.shape[0]):
            if modes[spans[t]] == _STEP and shares[t] < 1:
                shares[t] = 0.0
    for t in range(times.shape[0]):
        spans[t] = start + (spans[t] - low) * width
    for c in range(width):
        for t in range(times.shape[0]):
            a, b, share = values[spans[t] + c], values[spans[t] + width + c], shares[t]
            rise = b - a
            out[row + c, t] = a + share * rise if share < half else b - (one - share) * rise


@kernel
def sample_tracks(times, tracks, keys, modes, values, tangents, handles, out):
    """All tracks at rising times (T,), into (D, T)."""
    count = times.shape[0]
    row = 0
    quaternion = np.empty(4)
    spans, shares = np.empty(count, np.int32), np.empty(count, values.dtype)
    for n in range(tracks.shape[0]):
        low, total, width = tracks[n, KEY], tracks[n, KEYS], tracks[n, WIDTH]
        start_value, kind = tracks[n, VALUE], tracks[n, KIND]
        first, last = keys[low], keys[low + total - 1]
        length = last - first
        if kind == LINES and count > 1 and total > 1 and times[0] >= first and times[count - 1] <= last:
            _lines(times, tracks, n, keys, modes, values, spans, shares, out, row)
            row += width
            continue
        one_mode = tracks[n, MODE]
        k = -1
        following, here, span, over, whole, share = low, 0.0, 0.0, 0.0, 0.0, 0.0
        for t in range(count):
            time = times[t]
            cycles, outside = 0.0, 0.0
            if total > 1 and (time < first or time > last):
                rule = tracks[n, BEFORE] if time < first else tracks[n, AFTER]
                if rule == GO_ON:
                    outside = time - first if time < first else time - last
                elif rule == PING_PONG:
                    whole = math.floor((time - first) / (2 * length))
                    over = (time - first) - whole * 2 * length
                    time = first + min(over, 2 * length - over)
                elif rule >= CYCLE:
                    whole = math.floor((time - first) / length)
                    over = (time - first) - whole * length
                    if over < 0:
                        whole, over = whole - 1, over + length
                    elif over >= length:
                        whole, over = whole + 1, over - length
                    time = first + over
                    if rule == CYCLE_OFFSET:
                        cycles = whole
            time = min(max(time, first), last)
            # Times that rise mostly stay in a span or go on to the next.
            if k < 0 or time < keys[k] or (k + 1 < low + total and time >= keys[k + 1]):
                if k >= 0 and time >= keys[k] and (k + 2 >= low + total or time < keys[k + 2]):
                    k += 1
                else:
                    k = _span_of(keys, low, total, time) if total > 1 else low
                here = keys[k]
                following = min(k + 1, low + total - 1)
                span = keys[following] - here
            share = (time - here) / span if span > 0 else 0.0
            mode = one_mode if one_mode >= 0 else np.int64(modes[k])
            at = start_value + (k - low) * width
            to = start_value + (following - low) * width
            if share == 0 or mode == _STEP:
                for c in range(width):
                    out[row + c, t] = values[at + c]
            elif kind == LINES or (mode == _LINEAR and kind != ROTATION):
                for c in range(width):
                    a, b = np.float64(values[at + c]), np.float64(values[to + c])
                    out[row + c, t] = a + share * (b - a) if share < 0.5 else b - (1 - share) * (b - a)
            elif mode == _LINEAR:
                dot = 0.0
                for c in range(4):
                    dot += np.float64(values[at + c]) * values[to + c]
                sign = -1.0 if dot < 0 else 1.0
                near, gap = 0.0, 0.0
                for c in range(
                    4
                ):  # half the angle from the difference and the sum, which are exact where the cosine is not
                    p, q = np.float64(values[at + c]), sign * values[to + c]
                    gap += (q - p) * (q - p)
                    near += (q + p) * (q + p)
                angle = 2 * math.atan2(math.sqrt(gap), math.sqrt(near))
                sine = math.sin(angle)
                x, y = 1 - share, share
                if sine > 1e-7:
                    x, y = math.sin((1 - share) * angle) / sine, math.sin(share * angle) / sine
                for c in range(4):
                    out[row + c, t] = x * values[at + c] + y * sign * values[to + c]
            elif mode == _HERMITE:
                m = tracks[n, TANGENT] + (2 * (k - low) + 1) * width  # out of this key, and then into the next
                size = 0.0
                for c in range(width):
                    x = _hermite(
                        np.float64(values[at + c]),
                        np.float64(tangents[m + c]),
                        np.float64(values[to + c]),
                        np.float64(tangents[m + width + c]),
                        share,
                        span,
                    )
                    if kind == ROTATION:
                        quaternion[c] = x
                        size += x * x
                    else:
                        out[row + c, t] = x
                if kind == ROTATION:
                    size = 1 / math.sqrt(size)
                    for c in range(4):
                        out[row + c, t] = quaternion[c] * size
            else:
                m = tracks[n, HANDLE] + 2 * (2 * (k - low) + 1) * width
                e = m + 2 * width
                for c in range(width):
                    out[row + c, t] = _bezier(
                        np.float64(values[at + c]),
                        np.float64(handles[m + 2 * c]),
                        np.float64(handles[m + 2 * c + 1]),
                        np.float64(values[to + c]),
                        np.float64(handles[e + 2 * c]),
                        np.float64(handles[e + 2 * c + 1]),
                        span,
                        share,
                    )
            if cycles != 0:
                end = start_value + (total - 1) * width
                for c in range(width):
                    out[row + c, t] += cycles * (np.float64(values[end + c]) - values[start_value + c])
            if outside != 0:
                near_key = low if outside < 0 else low + total - 2
                mode = modes[near_key]
                if mode != _STEP:
                    span_s = keys[near_key + 1] - keys[near_key]
                    a = start_value + (near_key - low) * width
                    own = start_value + (0 if outside < 0 else total - 1) * width
                    # the side that lies within the keys: out of the first, into the last
                    side = 2 * (own - start_value) + (width if outside < 0 else 0)
                    for c in range(width):
                        slope = (np.float64(values[a + width + c]) - values[a + c]) / span_s
                        if mode == _HERMITE:
                            slope = np.float64(tangents[tracks[n, TANGENT] + side + c])
                        elif mode > _HERMITE:
                            handle = tracks[n, HANDLE] + 2 * (side + c)
                            if handles[handle] != 0:
                                slope = np.float64(handles[handle + 1]) / handles[handle]
                        out[row + c, t] = values[own + c] + outside * slope
        row += width


@kernel
def choose_keys(values, weights, longest, keys):
    """The keys (indices, falling) that cost least: 1 each, and the weighted squares of what cubics between them miss.

    Cubics go through the values (T, C) of their two keys, with the tangents of least squares. Returns how many.
    Source: shortest path over all pairs of keys; the sums of a pair are those of the one before it and one frame more.
    """
    frames, width = values.shape
    cost, before = np.full(frames, np.inf), np.zeros(frames, np.int64)
    cost[0] = 0.0
    moments, powers = np.empty((4, width)), np.empty(7)
    for a in range(frames - 1):
        base = cost[a] + 1.0
        moments[:] = 0.0
        powers[:] = 0.0
        squares = 0.0
        for b in range(a + 1, min(a + longest, frames - 1) + 1):
            n = float(b - a)
            x = weights[b]
            for p in range(7):
                powers[p] += x
                x *= n
            rise = 0.0
            for c in range(width):
                d = values[b, c] - values[a, c]
                rise += d * d
                x = weights[b] * d
                for p in range(4):
                    moments[p, c] += x
                    x *= n
            squares += weights[b] * rise
            missed = 0.0
            if b - a > 2:
                i = 1 / n
                i2 = i * i
                i3 = i2 * i
                p2, p3, p4 = powers[2] * i2, powers[3] * i3, powers[4] * i2 * i2
                p5, p6 = powers[5] * i2 * i3, powers[6] * i3 * i3
                # the normal equations of both tangents: sums of products of u (1-u)^2 and -u^2 (1-u)
                aa = p2 - 4 * p3 + 6 * p4 - 4 * p5 + p6
                ab = 3 * p4 - p3 - 3 * p5 + p6
                bb = p4 - 2 * p5 + p6
                e1, e2 = 3 * p3 - 8 * p4 + 7 * p5 - 2 * p6, 5 * p5 - 3 * p4 - 2 * p6
                determinant = aa * bb - ab * ab
                missed = squares + rise * (9 * p4 - 12 * p5 + 4 * p6)
                for c in range(width):
                    d = values[b, c] - values[a, c]
                    y1, y2, y3 = moments[1, c] * i, moments[2, c] * i2, moments[3, c] * i3
                    r1, r2 = y1 - 2 * y2 + y3 - d * e1, y3 - y2 - d * e2
                    missed -= 2 * d * (3 * y2 - 2 * y3)
                    missed -= (r1 * (bb * r1 - ab * r2) + r2 * (aa * r2 - ab * r1)) / determinant
                missed = max(missed, 0.0)
            if base + missed < cost[b]:
                cost[b], before[b] = base + missed, a
            if missed > 6.0:  # it hardly falls again with a longer span
                break
    count, k = 0, frames - 1
    while k > 0:
        keys[count] = k
        count += 1
        k = before[k]
    keys[count] = 0
    return count + 1


@kernel
def fit_spans(values, weights, keys, unit, tangents, fitted):
    """Tangents (S, 2, C) per frame of the cubics between keys (S+1,) rising, and the cubics at all frames, (T, C).

    With ``unit`` the cubics are normalised.
    """
    width = values.shape[1]
    fitted[0] = values[0]
    for s in range(keys.shape[0] - 1):
        a, b = keys[s], keys[s + 1]
        n = b - a
        aa = ab = bb = 0.0
        for i in range(1, n):
            u = i / n
            g, h, w = u * (1 - u) * (1 - u), -u * u * (1 - u), weights[a + i]
            aa, ab, bb = aa + w * g * g, ab + w * g * h, bb + w * h * h
        determinant = aa * bb - ab * ab
        for c in range(width):
            d = values[b, c] - values[a, c]
            m0 = m1 = d
            if n == 2:
                r = values[a + 1, c] - 0.5 * (values[a, c] + values[b, c])
                m0, m1 = d + 4 * r, d - 4 * r
            elif n > 2:
                r0 = r1 = 0.0
                for i in range(1, n):
                    u = i / n
                    r = weights[a + i] * (values[a + i, c] - values[a, c] - d * u * u * (3 - 2 * u))
                    r0, r1 = r0 + u * (1 - u) * (1 - u) * r, r1 - u * u * (1 - u) * r
                m0, m1 = (bb * r0 - ab * r1) / determinant, (aa * r1 - ab * r0) / determinant
            tangents[s, 0, c], tangents[s, 1, c] = m0 / n, m1 / n
            for i in range(1, n + 1):
                u = i / n
                v = 1 - u
                fitted[a + i, c] = values[a, c] + d * u * u * (3 - 2 * u) + m0 * u * v * v - m1 * u * u * v
        if unit:
            for i in range(1, n + 1):
                size = 0.0
                for c in range(width):
                    size += fitted[a + i, c] * fitted[a + i, c]
                size = 1 / math.sqrt(size)
                for c in range(width):
                    fitted[a + i, c] *= size
