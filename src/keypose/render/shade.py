# pyright: basic
"""Numba kernels of the software backend: light, textures, floor and sky, as the shaders of the OpenGL backend have them.

Every function says which shader it mirrors; a change there belongs here too.
"""

import numpy as np
from numba import njit

from keypose.render.frame import (
    CENTER,
    EYE,
    FILL,
    FILL_COLOR,
    FLOOR_COLOR,
    FOCUS,
    FORWARD,
    GRID_COLOR,
    GROUND_AMBIENT,
    HORIZON,
    KEY,
    KEY_COLOR,
    LIGHT_FROM_WORLD,
    RIM,
    RIM_COLOR,
    SHADOW_COLOR,
    SKY_AMBIENT,
    ZENITH,
)
from keypose.render.raster import draw_triangle, span, touch

# columns of the table of surfaces
BASE, EMISSIVE, METALLIC, ROUGHNESS, CUTOFF, OPACITY, UNLIT, FLAT, OVERLAY = 0, 4, 7, 8, 9, 10, 11, 12, 13
FIRST_LEVEL, LEVELS, GHOST, TINT, STRENGTH, WINDING, CULLED, SURFACE_COLUMNS = 14, 15, 16, 17, 20, 21, 22, 23
ENCODE_STEPS = 16384

_K = np.arange(ENCODE_STEPS + 1) / ENCODE_STEPS
ENCODED = np.where(_K <= 0.0031308, 12.92 * _K, 1.055 * _K ** (1 / 2.4) - 0.055).astype(np.float32)
_K = np.arange(256) / 255
LINEAR = np.where(_K <= 0.04045, _K / 12.92, ((_K + 0.055) / 1.055) ** 2.4).astype(np.float32)


@njit(cache=True, nogil=True)
def smoothstep(low, high, x):
    u = min(max((x - low) / (high - low), 0.0), 1.0)
    return u * u * (3 - 2 * u)


@njit(cache=True, nogil=True)
def mix(a, b, u):
    return a + (b - a) * u


@njit(cache=True, nogil=True)
def encode(c):
    return ENCODED[int(min(max(c, 0.0), 1.0) * ENCODE_STEPS + 0.5)]


@njit(cache=True, nogil=True)
def fract(x):
    return x - np.floor(x)


@njit(cache=True, nogil=True)
def lines(at_x, at_y, foot_x, foot_y, width):
    """ground.frag: lines."""
    ax, bx = at_x + 0.5 * foot_x + 0.5 * width, at_x - 0.5 * foot_x + 0.5 * width
    ay, by = at_y + 0.5 * foot_y + 0.5 * width, at_y - 0.5 * foot_y + 0.5 * width
    sx = (np.floor(ax) * width + min(fract(ax), width) - np.floor(bx) * width - min(fract(bx), width)) / foot_x
    sy = (np.floor(ay) * width + min(fract(ay), width) - np.floor(by) * width - min(fract(by), width)) / foot_y
    return 1 - (1 - sx) * (1 - sy)


@njit(cache=True, nogil=True)
def draw_backdrop(frame, floor_from_pixel, ground, width, height, top, bottom, out, shown):
    """sky.frag and ground.frag: rows top..bottom - 1 of the picture without a subject, (H, W, 3), and as bytes."""
    focus_x, focus_z, reach, cell = frame[FOCUS, 0], frame[FOCUS, 2], frame[FOCUS, 3], frame[KEY_COLOR, 3]
    m = floor_from_pixel
    for y in range(top, bottom):
        py = y + 0.5
        up = height - py  # OpenGL counts rows from the bottom
        at_y = up / height
        base_y = 52.9829189
        for x in range(width):
            px = x + 0.5
            at_x = px / width
            # backdrop() of frame.glsl
            rise = smoothstep(0.30, 1.15, at_y)
            away_x, away_y = (at_x - 0.5) * 0.55, (at_y - 0.55) * 0.45
            u = min(max(rise * 0.85 + (away_x * away_x + away_y * away_y) * 0.55, 0.0), 1.0)
            r = mix(frame[HORIZON, 0], frame[ZENITH, 0], u)
            g = mix(frame[HORIZON, 1], frame[ZENITH, 1], u)
            b = mix(frame[HORIZON, 2], frame[ZENITH, 2], u)
            q = m[2, 0] * px + m[2, 1] * py + m[2, 2]
            if ground and q > 0:
                wx = (m[0, 0] * px + m[0, 1] * py + m[0, 2]) / q
                wz = (m[1, 0] * px + m[1, 1] * py + m[1, 2]) / q
                dx, dz = (wx - focus_x) / reach, (wz - focus_z) / reach
                far2 = dx * dx + dz * dz
                pool = 1 / (1 + far2 * far2 / 45)
                r, g, b = (
                    mix(r, frame[FLOOR_COLOR, 0], pool),
                    mix(g, frame[FLOOR_COLOR, 1], pool),
                    mix(b, frame[FLOOR_COLOR, 2], pool),
                )
                fade = frame[FILL, 3] / (1 + far2 * far2 / 19)
                if fade > 1e-3:
                    step_x = max(abs(m[0, 0] - wx * m[2, 0]), abs(m[0, 1] - wx * m[2, 1])) / (q * cell)
                    step_z = max(abs(m[1, 0] - wz * m[2, 0]), abs(m[1, 1] - wz * m[2, 1])) / (q * cell)
                    foot_x, foot_z = step_x * 1.25 + 1e-5, step_z * 1.25 + 1e-5
                    strong = lines(wx / cell, wz / cell, foot_x, foot_z, 0.016)
                    weak = lines(wx / cell * 5, wz / cell * 5, foot_x * 5, foot_z * 5, 0.034)
                    weak *= 1 - smoothstep(0.08, 0.35, 5 * max(foot_x, foot_z))
                    ink = min((strong + 0.30 * weak), 1 / max(fade / max(frame[FILL, 3], 1e-9), 1e-9)) * fade
                    r, g, b = (
                        mix(r, frame[GRID_COLOR, 0], ink),
                        mix(g, frame[GRID_COLOR, 1], ink),
                        mix(b, frame[GRID_COLOR, 2], ink),
                    )
            noise = (fract(base_y * fract(px * 0.06711056 + up * 0.00583715)) - 0.5) / 255
            out[y, x, 0], out[y, x, 1], out[y, x, 2] = r + noise, g + noise, b + noise
            for channel in range(3):
                shown[y, x, channel] = int(min(max(out[y, x, channel], 0.0), 1.0) * 255 + 0.5)
            shown[y, x, 3] = 255


@njit(cache=True, nogil=True)
def bilinear(plane, u, v, channel):
    """A plane (n, n, c) between its texels at 0..1, clamped at the rim."""
    n = len(plane)
    x, y = min(max(u * n - 0.5, 0.0), n - 1.0), min(max(v * n - 0.5, 0.0), n - 1.0)
    i, j = min(int(x), n - 2), min(int(y), n - 2)
    s, t = x - i, y - j
    upper = plane[j, i, channel] * (1 - s) + plane[j, i + 1, channel] * s
    lower = plane[j + 1, i, channel] * (1 - s) + plane[j + 1, i + 1, channel] * s
    return upper * (1 - t) + lower * t


@njit(cache=True, nogil=True)
def floor_shade(frame, crisp, soft, contact, wx, wz):
    """shade.frag: how dark the subject's shadow makes a place of the floor."""
    light = frame[LIGHT_FROM_WORLD : LIGHT_FROM_WORLD + 4]
    wy = frame[FORWARD, 3]
    u = 0.5 + 0.5 * (light[0, 0] * wx + light[1, 0] * wy + light[2, 0] * wz + light[3, 0])
    v = 0.5 - 0.5 * (light[0, 1] * wx + light[1, 1] * wy + light[2, 1] * wz + light[3, 1])
    dark = 0.0
    if 0 < u < 1 and 0 < v < 1:
        share = bilinear(soft, u, v, 0)
        if share > 1e-4:
            gap = 4 * bilinear(soft, u, v, 1) / max(share, 1e-3)
            dark = mix(bilinear(crisp, u, v, 0), share, smoothstep(0.02, 0.8, gap))
            dark *= mix(0.78, 0.5, smoothstep(0.1, 1.6, gap))
    u = 0.5 + 0.5 * (wx - frame[CENTER, 0]) / (1.15 * frame[CENTER, 3])
    v = 0.5 - 0.5 * (wz - frame[CENTER, 2]) / (1.15 * frame[CENTER, 3])
    if 0 < u < 1 and 0 < v < 1:
        dark = 1 - (1 - dark) * (1 - 0.75 * bilinear(contact, u, v, 0))
    return dark


@njit(cache=True, nogil=True)
def sunlit(frame, depth, x, y, z, nx, ny, nz, facing):
    """surface.frag: sunlit."""
    if frame[KEY, 3] < 0.5:
        return 1.0
    size = len(depth)
    texel = 2 * frame[CENTER, 3] / size
    out = texel * (1.2 + 2.2 * (1 - min(max(facing, 0.0), 1.0)))
    mx = x + nx * out + frame[KEY, 0] * texel * 0.8
    my = y + ny * out + frame[KEY, 1] * texel * 0.8
    mz = z + nz * out + frame[KEY, 2] * texel * 0.8
    light = frame[LIGHT_FROM_WORLD : LIGHT_FROM_WORLD + 4]
    u = 0.5 + 0.5 * (light[0, 0] * mx + light[1, 0] * my + light[2, 0] * mz + light[3, 0])
    v = 0.5 - 0.5 * (light[0, 1] * mx + light[1, 1] * my + light[2, 1] * mz + light[3, 1])
    here = light[0, 2] * mx + light[1, 2] * my + light[2, 2] * mz + light[3, 2]
    if not (0 <= u <= 1 and 0 <= v <= 1 and -1 <= here <= 1):
        return 1.0
    # nine comparisons of four texels each, 1.6 texels apart: the same as 5.2 x 5.2 weighted texels
    total = 0.0
    for j in range(-1, 2):
        for i in range(-1, 2):
            px, py = u * size - 0.5 + 1.6 * i, v * size - 0.5 + 1.6 * j
            fx, fy = np.floor(px), np.floor(py)
            s, t = px - fx, py - fy
            c0, c1 = min(max(int(fx), 0), size - 1), min(max(int(fx) + 1, 0), size - 1)
            r0, r1 = min(max(int(fy), 0), size - 1), min(max(int(fy) + 1, 0), size - 1)
            lit_share = 0.0
            if here <= depth[r0, c0]:
                lit_share += (1 - s) * (1 - t)
            if here <= depth[r0, c1]:
                lit_share += s * (1 - t)
            if here <= depth[r1, c0]:
                lit_share += (1 - s) * t
            if here <= depth[r1, c1]:
                lit_share += s * t
            total += lit_share * (2 - abs(i)) * (2 - abs(j))
    return total / 16


@njit(cache=True, nogil=True)
def texture(texels, levels, first, count, u, v, footprint):
    """Linear RGBA of a texture that repeats, from the mip level that fits the footprint (in widths of the texture)."""
    level = 0
    size = footprint * max(levels[first, 1], levels[first, 2])
    while level < count - 1 and size > 1.5:
        size *= 0.5
        level += 1
    start, width, height = levels[first + level, 0], levels[first + level, 1], levels[first + level, 2]
    x, y = fract(u) * width - 0.5, fract(v) * height - 0.5
    fx, fy = np.floor(x), np.floor(y)
    s, t = x - fx, y - fy
    x0, y0 = (int(fx) + width) % width, (int(fy) + height) % height
    x1, y1 = (x0 + 1) % width, (y0 + 1) % height
    r = g = b = a = 0.0
    for k in range(4):
        row = start + (y1 if k >= 2 else y0) * width + (x1 if k % 2 else x0)
        w = (t if k >= 2 else 1 - t) * (s if k % 2 else 1 - s)
        r += w * LINEAR[texels[row, 0]]
        g += w * LINEAR[texels[row, 1]]
        b += w * LINEAR[texels[row, 2]]
        a += w * texels[row, 3]
    return r, g, b, a / 255


@njit(cache=True, nogil=True)
def barycentric(row, px, py):
    a = row[0] * px + row[1] * py + row[2]
    b = row[3] * px + row[4] * py + row[5]
    c = row[6] * px + row[7] * py + row[8]
    total = a + b + c
    return a / total, b / total, c / total


@njit(cache=True, nogil=True)
def base_color(surface, row, corner, uvs, colors, texels, levels, px, py, a, b, c):
    """Base colour times vertex colour times texture, linear RGBA."""
    i, j, k = corner[0], corner[1], corner[2]
    red = surface[BASE] * (a * colors[i, 0] + b * colors[j, 0] + c * colors[k, 0])
    green = surface[BASE + 1] * (a * colors[i, 1] + b * colors[j, 1] + c * colors[k, 1])
    blue = surface[BASE + 2] * (a * colors[i, 2] + b * colors[j, 2] + c * colors[k, 2])
    alpha = surface[BASE + 3] * (a * colors[i, 3] + b * colors[j, 3] + c * colors[k, 3])
    if surface[FIRST_LEVEL] >= 0:
        u = a * uvs[i, 0] + b * uvs[j, 0] + c * uvs[k, 0]
        v = a * uvs[i, 1] + b * uvs[j, 1] + c * uvs[k, 1]
        d, e, f = barycentric(row, px + 1, py)
        du, dv = d * uvs[i, 0] + e * uvs[j, 0] + f * uvs[k, 0] - u, d * uvs[i, 1] + e * uvs[j, 1] + f * uvs[k, 1] - v
        d, e, f = barycentric(row, px, py + 1)
        eu, ev = d * uvs[i, 0] + e * uvs[j, 0] + f * uvs[k, 0] - u, d * uvs[i, 1] + e * uvs[j, 1] + f * uvs[k, 1] - v
        footprint = np.sqrt(min(max(du * du + dv * dv, eu * eu + ev * ev), 1.0))
        r, g, bl, al = texture(texels, levels, int(surface[FIRST_LEVEL]), int(surface[LEVELS]), u, v, footprint)
        red, green, blue, alpha = red * r, green * g, blue * bl, alpha * al
    return red, green, blue, alpha


@njit(cache=True, nogil=True)
def shade(frame, surface, row, corner, world, normals, uvs, colors, texels, levels, depth, px, py):
    """surface.frag: main; the colour as shown and the opacity of a triangle at a place of the picture."""
    a, b, c = barycentric(row, px, py)
    red, green, blue, alpha = base_color(surface, row, corner, uvs, colors, texels, levels, px, py, a, b, c)
    alpha = (1.0 if surface[CUTOFF] >= 0 else alpha) * surface[OPACITY]
    i, j, k = corner[0], corner[1], corner[2]
    x = a * world[i, 0] + b * world[j, 0] + c * world[k, 0]
    y = a * world[i, 1] + b * world[j, 1] + c * world[k, 1]
    z = a * world[i, 2] + b * world[j, 2] + c * world[k, 2]
    if frame[EYE, 3] > 0.5:
        vx, vy, vz = -frame[FORWARD, 0], -frame[FORWARD, 1], -frame[FORWARD, 2]
    else:
        vx, vy, vz = frame[EYE, 0] - x, frame[EYE, 1] - y, frame[EYE, 2] - z
        scale = 1 / np.sqrt(vx * vx + vy * vy + vz * vz)
        vx, vy, vz = vx * scale, vy * scale, vz * scale
    if surface[FLAT] > 0:
        px1, py1, pz1 = world[j, 0] - world[i, 0], world[j, 1] - world[i, 1], world[j, 2] - world[i, 2]
        px2, py2, pz2 = world[k, 0] - world[i, 0], world[k, 1] - world[i, 1], world[k, 2] - world[i, 2]
        nx, ny, nz = py1 * pz2 - pz1 * py2, pz1 * px2 - px1 * pz2, px1 * py2 - py1 * px2
        turned = nx * vx + ny * vy + nz * vz < 0
    else:
        nx = a * normals[i, 0] + b * normals[j, 0] + c * normals[k, 0]
        ny = a * normals[i, 1] + b * normals[j, 1] + c * normals[k, 1]
        nz = a * normals[i, 2] + b * normals[j, 2] + c * normals[k, 2]
        turned = row[16] * surface[WINDING] < 0
    size = np.sqrt(nx * nx + ny * ny + nz * nz)
    scale = (-1.0 if turned else 1.0) / size if size > 0 else 0.0
    nx, ny, nz = nx * scale, ny * scale, nz * scale
    nv = nx * vx + ny * vy + nz * vz
    if surface[UNLIT] <= 0:
        facing = nx * frame[KEY, 0] + ny * frame[KEY, 1] + nz * frame[KEY, 2]
        sun = 1.0
        if surface[OVERLAY] <= 0 and facing >= -0.12:
            sun = sunlit(frame, depth, x, y, z, nx, ny, nz, facing)
        height = smoothstep(0.0, 0.45, (y - frame[FORWARD, 3]) / frame[CENTER, 3])
        red, green, blue = lit(
            frame, surface, red, green, blue, nx, ny, nz, vx, vy, vz, max(nv, 1e-3), facing, sun, height
        )
        red, green, blue = tone(red + surface[EMISSIVE], green + surface[EMISSIVE + 1], blue + surface[EMISSIVE + 2])
    if surface[GHOST] > 0:
        red = mix(red, surface[TINT], surface[STRENGTH])
        green = mix(green, surface[TINT + 1], surface[STRENGTH])
        blue = mix(blue, surface[TINT + 2], surface[STRENGTH])
        alpha *= mix(0.55, 1.0, (1 - max(nv, 0.0)) ** 1.5)
    return encode(red), encode(green), encode(blue), alpha


@njit(cache=True, nogil=True)
def lit(frame, surface, red, green, blue, nx, ny, nz, vx, vy, vz, nv, facing, sun, height):
    """surface.frag: lit."""
    metallic, roughness = surface[METALLIC], surface[ROUGHNESS]
    key = min(max((facing + 0.12) / 1.12, 0.0), 1.0) * sun
    fill = min(max((nx * frame[FILL, 0] + ny * frame[FILL, 1] + nz * frame[FILL, 2]) * 0.5 + 0.5, 0.0), 1.0)
    up = ny * 0.5 + 0.5
    open_ = mix(0.62 + 0.38 * up, 1.0, height)
    alpha = max(roughness * roughness, 0.02)
    hx, hy, hz = frame[KEY, 0] + vx, frame[KEY, 1] + vy, frame[KEY, 2] + vz
    size = np.sqrt(hx * hx + hy * hy + hz * hz)
    scale = 1 / size if size > 0 else 0.0
    hx, hy, hz = hx * scale, hy * scale, hz * scale
    nh, vh = max(nx * hx + ny * hy + nz * hz, 0.0), max(vx * hx + vy * hy + vz * hz, 0.0)
    a2 = alpha * alpha
    spread = nh * nh * (a2 - 1) + 1
    lobe = min(a2 / (spread * spread) / (4 * mix(vh * vh, 1.0, 0.5 * alpha + 0.25)), 12.0) * max(facing, 0.0) * sun
    edge = mix(0.18, 0.9, roughness)
    mirror_y = 2 * (nx * vx + ny * vy + nz * vz) * ny - vy
    ceiling = smoothstep(-edge, edge, mirror_y)
    rim = (1 - nv) ** 3 * smoothstep(-0.25, 0.75, nx * frame[RIM, 0] + ny * frame[RIM, 1] + nz * frame[RIM, 2])
    r = g = b = 0.0
    for channel in range(3):
        base = red if channel == 0 else (green if channel == 1 else blue)
        ambient = mix(frame[GROUND_AMBIENT, channel], frame[SKY_AMBIENT, channel], up) * open_
        light = frame[KEY_COLOR, channel] * key + frame[FILL_COLOR, channel] * fill * fill + ambient
        f0 = mix(0.04, base, metallic)
        shine = frame[KEY_COLOR, channel] * (f0 + (1 - f0) * (1 - vh) ** 5) * lobe
        around = mix(frame[GROUND_AMBIENT, channel], frame[SKY_AMBIENT, channel] * 1.35, ceiling)
        shine += around * (f0 + (max(1 - roughness, f0) - f0) * (1 - nv) ** 5) * open_
        value = base * (1 - metallic) * light + shine
        value += frame[RIM_COLOR, channel] * rim * mix(0.35, base + 0.15, 0.6)
        if channel == 0:
            r = value
        elif channel == 1:
            g = value
        else:
            b = value
    return r, g, b


@njit(cache=True, nogil=True)
def tone(r, g, b):
    """surface.frag: tone (Khronos PBR Neutral)."""
    low = min(r, g, b)
    dark = low - 6.25 * low * low if low < 0.08 else 0.04
    r, g, b = r - dark, g - dark, b - dark
    peak = max(r, g, b)
    if peak < 0.76:
        return r, g, b
    bent = 1 - 0.0576 / (peak + 0.24 - 0.76)
    r, g, b = r * bent / peak, g * bent / peak, b * bent / peak
    share = 1 / (0.15 * (peak - bent) + 1)
    return mix(bent, r, share), mix(bent, g, share), mix(bent, b, share)


@njit(cache=True, nogil=True)
def draw_layer(
    setups, members, owners, surfaces, layers, wanted, triangles, uvs, colors, texels, levels, offsets, reach,
    top, bottom, depth, visible, touched,
):  # fmt: skip
    """Depth and triangle of every sample of a band, for the triangles of one layer."""
    for m in range(len(members)):
        t = members[m]
        if layers[t] != wanted:
            continue
        row, surface = setups[t], surfaces[owners[t]]
        if surface[CULLED] > 0 and row[16] * surface[WINDING] < 0:
            continue
        if surface[CUTOFF] > 0:
            draw_masked(
                row, t, surface, triangles[t], uvs, colors, texels, levels, offsets, reach, top, bottom, depth, visible,
                touched,
            )  # fmt: skip
        else:
            draw_triangle(row, t, offsets, len(offsets), reach, top, bottom, depth, visible, touched)


@njit(cache=True, nogil=True)
def draw_masked(
    row, t, surface, corner, uvs, colors, texels, levels, offsets, reach, top, bottom, depth, visible, touched
):
    """One triangle with holes: the alpha of each pixel decides for all its samples."""
    for y in range(max(top, int(row[14])), min(bottom - 1, int(row[15])) + 1):
        first, last = span(row, y, reach, reach, int(row[12]), int(row[13]))
        if last < first:
            continue
        touch(touched, y - top, first, last + 1)
        for x in range(first, last + 1):
            tested, kept = False, True
            for s in range(len(offsets)):
                px, py = x + 0.5 + offsets[s, 0], y + 0.5 + offsets[s, 1]
                if row[0] * px + row[1] * py + row[2] < 0 or row[3] * px + row[4] * py + row[5] < 0:
                    continue
                if row[6] * px + row[7] * py + row[8] < 0:
                    continue
                z = row[9] * px + row[10] * py + row[11]
                if not (-1 <= z < depth[y - top, x, s]):
                    continue
                if not tested:
                    a, b, c = barycentric(row, px, py)
                    _, _, _, alpha = base_color(surface, row, corner, uvs, colors, texels, levels, px, py, a, b, c)
                    tested, kept = True, alpha >= surface[CUTOFF]
                if kept:
                    depth[y - top, x, s] = z
                    visible[y - top, x, s] = t


@njit(cache=True, nogil=True)
def compose_band(
    frame, floor_from_pixel, floor_depth, has_floor, transparent, setups, members, owners, surfaces, layers,
    ghost_layers, glass, triangles, world, normals, uvs, colors, texels, levels, sun_depth, crisp, soft, contact,
    shadow_box, offsets, reach, still, top, bottom, depth, visible, ink, out,
):  # fmt: skip
    """Rows top..bottom - 1 of the picture, (H, W, 4) uint8 premultiplied.

    ``out`` already holds the backdrop. ``depth`` (1 everywhere), ``visible`` (-1 everywhere) (rows, W, samples) and
    ``ink`` (rows, W, 4) are room to work in. ``shadow_box`` holds the pixels (left, right, top, bottom) in which the floor may be in
    shadow. ``glass`` are the triangles that others show through, from far to near.
    """
    rows, width, samples = bottom - top, depth.shape[1], depth.shape[2]
    touched = np.empty((rows, 2), np.int64)
    touched[:, 0], touched[:, 1] = width, 0
    inked = np.empty((rows, 2), np.int64)  # where the ink has been laid out already
    inked[:, 0], inked[:, 1] = width, 0
    shadows = has_floor and frame[KEY, 3] > 0.5
    for ghost in range(1, ghost_layers + 1):
        draw_layer(
            setups, members, owners, surfaces, layers, ghost, triangles, uvs, colors, texels, levels, offsets, reach,
            top, bottom, depth, visible, touched,
        )  # fmt: skip
        lay_out(transparent, still, top, touched, inked, ink)
        for y in range(rows):
            paint(
                frame, setups, owners, surfaces, triangles, world, normals, uvs, colors, texels, levels, sun_depth,
                offsets, top, y, touched[y, 0], touched[y, 1], visible, ink,
            )  # fmt: skip
            for x in range(touched[y, 0], touched[y, 1]):
                depth[y, x], visible[y, x] = 1.0, -1
    draw_layer(
        setups, members, owners, surfaces, layers, 0, triangles, uvs, colors, texels, levels, offsets, reach,
        top, bottom, depth, visible, touched,
    )  # fmt: skip
    for y in range(rows):
        if shadows and shadow_box[2] <= top + y <= shadow_box[3]:
            touch(touched, y, shadow_box[0], shadow_box[1] + 1)
    for g in range(len(glass)):
        row = setups[glass[g]]
        for y in range(max(top, int(row[14])), min(bottom - 1, int(row[15])) + 1):
            touch(touched, y - top, int(row[12]), int(row[13]) + 1)
    lay_out(transparent, still, top, touched, inked, ink)
    if has_floor:
        m = floor_from_pixel
        for y in range(rows):
            py = top + y + 0.5
            row_shaded = shadows and shadow_box[2] <= top + y <= shadow_box[3]
            for x in range(touched[y, 0], touched[y, 1]):
                px = x + 0.5
                q = m[2, 0] * px + m[2, 1] * py + m[2, 2]
                if q <= 0:
                    continue
                z = floor_depth[0] * px + floor_depth[1] * py + floor_depth[2]
                open_ = False
                for s in range(samples):
                    if depth[y, x, s] > z:
                        visible[y, x, s] = -1  # under the floor
                        depth[y, x, s] = z
                        open_ = True
                if open_ and row_shaded and shadow_box[0] <= x <= shadow_box[1]:
                    wx = (m[0, 0] * px + m[0, 1] * py + m[0, 2]) / q
                    wz = (m[1, 0] * px + m[1, 1] * py + m[1, 2]) / q
                    dark = floor_shade(frame, crisp, soft, contact, wx, wz)
                    if dark > 0:
                        for channel in range(3):
                            ink[y, x, channel] = ink[y, x, channel] * (1 - dark) + frame[SHADOW_COLOR, channel] * dark
                        ink[y, x, 3] = ink[y, x, 3] * (1 - dark) + dark
    for y in range(rows):
        paint(
            frame, setups, owners, surfaces, triangles, world, normals, uvs, colors, texels, levels, sun_depth,
            offsets, top, y, touched[y, 0], touched[y, 1], visible, ink,
        )  # fmt: skip
    if len(glass):
        for y in range(rows):
            for x in range(touched[y, 0], touched[y, 1]):
                visible[y, x] = -1
    for g in range(len(glass)):
        t = glass[g]
        row, surface = setups[t], surfaces[owners[t]]
        if row[15] < top or row[14] >= bottom or (surface[CULLED] > 0 and row[16] * surface[WINDING] < 0):
            continue
        draw_triangle(row, t, offsets, samples, reach, top, bottom, depth, visible, touched)
        left, right = int(row[12]), int(row[13]) + 1
        for y in range(max(top, int(row[14])) - top, min(bottom - 1, int(row[15])) + 1 - top):
            paint(
                frame, setups, owners, surfaces, triangles, world, normals, uvs, colors, texels, levels, sun_depth,
                offsets, top, y, left, right, visible, ink,
            )  # fmt: skip
            for x in range(left, right):
                visible[y, x] = -1
    for y in range(rows):
        for x in range(touched[y, 0], touched[y, 1]):
            for channel in range(4):
                out[top + y, x, channel] = int(min(max(ink[y, x, channel], 0.0), 1.0) * 255 + 0.5)
            for s in range(samples):
                depth[y, x, s], visible[y, x, s] = 1.0, -1


@njit(cache=True, nogil=True)
def lay_out(transparent, still, top, touched, inked, ink):
    """The backdrop as ink wherever something was touched and none was laid out before."""
    for y in range(len(touched)):
        first, end = touched[y, 0], touched[y, 1]
        for x in range(first, end):
            if inked[y, 0] <= x < inked[y, 1]:
                continue
            for channel in range(3):
                ink[y, x, channel] = 0.0 if transparent else still[top + y, x, channel]
            ink[y, x, 3] = 0.0 if transparent else 1.0
        inked[y, 0], inked[y, 1] = min(inked[y, 0], first), max(inked[y, 1], end)


@njit(cache=True, nogil=True)
def paint(
    frame, setups, owners, surfaces, triangles, world, normals, uvs, colors, texels, levels, sun_depth, offsets,
    top, y, left, right, visible, ink,
):  # fmt: skip
    """Shade what is visible in a row, each triangle once per pixel, and lay it over the ink by its share of samples."""
    samples = visible.shape[2]
    for x in range(left, right):
        covered = 0.0
        red = green = blue = opaque = 0.0
        for s in range(samples):
            t = visible[y, x, s]
            if t < 0:
                continue
            done = False
            for earlier in range(s):
                if visible[y, x, earlier] == t:
                    done = True
                    break
            if done:
                continue
            count, mx, my = 0, 0.0, 0.0
            for other in range(s, samples):
                if visible[y, x, other] == t:
                    count += 1
                    mx += offsets[other, 0]
                    my += offsets[other, 1]
            r, g, b, a = shade(
                frame, surfaces[owners[t]], setups[t], triangles[t], world, normals, uvs, colors, texels, levels,
                sun_depth, x + 0.5 + mx / count, top + y + 0.5 + my / count,
            )  # fmt: skip
            share = count / samples
            red, green, blue, opaque = (
                red + share * r * a,
                green + share * g * a,
                blue + share * b * a,
                opaque + share * a,
            )
            covered += share
        if covered > 0:
            left = 1 - opaque
            ink[y, x, 0] = red + left * ink[y, x, 0]
            ink[y, x, 1] = green + left * ink[y, x, 1]
            ink[y, x, 2] = blue + left * ink[y, x, 2]
            ink[y, x, 3] = opaque + left * ink[y, x, 3]
