"""Draws the pictures of docs/principles.md and docs/rotations.md: ``python docs/pictures_principles.py`` (writes docs/images)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from keypose import samples
from keypose.editing.arcs import arcs
from keypose.editing.ease import ease_spans
from keypose.editing.follow import follow_through
from keypose.editing.moves import anticipate, moving_hold, overshoot
from keypose.editing.squash import squash_and_stretch
from keypose.editing.stopmotion import stop_motion
from keypose.evaluate import sample_clip, sample_curve, world_rotations_positions
from keypose.math import ease, quat
from keypose.math import rotation_splines as splines
from keypose.model import Channel, Clip, Curve, CurveKind, Interpolation, Motion, Pose, Property, Scene, Skeleton
from keypose.render import Camera, RenderSettings, render_image

IMAGES = Path(__file__).parent / "images"

PAPER, INK, FAINT, GRID = "#f7f8fb", "#2b3244", "#8f98ad", "#dfe3ec"
CORAL, BLUE, GREEN, GOLD = "#e0492f", "#3a6ea5", "#3d8f6a", "#c98a1b"
SHARP = 3  # drawn so many times as large, then made smaller


class Sheet:
    """A drawing with soft edges, in pixels of the finished picture."""

    def __init__(self, width: int, height: int) -> None:
        self.size = (width, height)
        self.image = Image.new("RGB", (width * SHARP, height * SHARP), PAPER)
        self.draw = ImageDraw.Draw(self.image)

    def line(self, points: Any, color: str, width: float = 1.6) -> None:
        places = [(float(x) * SHARP, float(y) * SHARP) for x, y in points]
        self.draw.line(places, fill=color, width=round(width * SHARP), joint="curve")

    def dot(self, x: float, y: float, radius: float, color: str, rim: str | None = None) -> None:
        box = [(v + s * radius) * SHARP for s in (-1, 1) for v in (x, y)]
        self.draw.ellipse(box, fill=color, outline=rim, width=round(1.2 * SHARP) if rim else 0)

    def diamond(self, x: float, y: float, color: str = GOLD) -> None:
        r = 4.5
        corners = [((x + a * r) * SHARP, (y + b * r) * SHARP) for a, b in ((0, -1), (1, 0), (0, 1), (-1, 0))]
        self.draw.polygon(corners, fill=color, outline=PAPER)

    def text(self, x: float, y: float, text: str, color: str = INK, size: float = 13, anchor: str = "la") -> None:
        self.draw.text(
            (x * SHARP, y * SHARP), text, fill=color, font=ImageFont.load_default(size * SHARP), anchor=anchor
        )

    def panel(self, box: tuple[float, float, float, float], title: str = "") -> None:
        x0, y0, x1, y1 = (v * SHARP for v in box)
        self.draw.rounded_rectangle((x0, y0, x1, y1), 6 * SHARP, fill="#ffffff", outline=GRID, width=SHARP)
        if title:
            self.text(box[0] + 10, box[1] + 8, title)

    def save(self, name: str) -> None:
        IMAGES.mkdir(exist_ok=True)
        small = self.image.resize(self.size, Image.Resampling.LANCZOS)
        small.save(IMAGES / name, optimize=True)
        print(f"{IMAGES / name}: {(IMAGES / name).stat().st_size // 1024} KB")


def mixed(a: str, b: str, share: float) -> str:
    """A colour between two."""
    first, second = ([int(c[i : i + 2], 16) for i in (1, 3, 5)] for c in (a, b))
    return "#" + "".join(f"{round(p + share * (q - p)):02x}" for p, q in zip(first, second, strict=True))


class Graph:
    """Time to the right, values up, inside a box."""

    def __init__(
        self, sheet: Sheet, box: tuple[float, float, float, float], times: Sequence[float], values: Sequence[float]
    ) -> None:
        self.sheet, self.box, self.times, self.values = sheet, box, times, values

    def at(self, time: Any, value: Any) -> Any:
        x0, y0, x1, y1 = self.box
        x = x0 + (np.asarray(time) - self.times[0]) / (self.times[1] - self.times[0]) * (x1 - x0)
        y = y1 - (np.asarray(value) - self.values[0]) / (self.values[1] - self.values[0]) * (y1 - y0)
        return np.stack(np.broadcast_arrays(x, y), axis=-1)

    def levels(self, values: Sequence[float]) -> None:
        for value in values:
            self.sheet.line(self.at(list(self.times), value), GRID, 1)

    def curve(self, curve: Curve, color: str, keys: bool = True, width: float = 2.2) -> None:
        at = np.linspace(*self.times, 900)
        self.sheet.line(self.at(at, sample_curve(curve, at)[:, 0]), color, width)
        if keys:
            for time, value in zip(curve.times_s, curve.values[:, 0], strict=True):
                if self.times[0] <= time <= self.times[1]:
                    self.sheet.diamond(*self.at(time, value))


# --- squash and stretch -------------------------------------------------------------------------------------------------


def strobe() -> None:
    """A bounce photographed sixteen times, without and with squash and stretch."""
    ball = samples.load("ball").character
    path = samples.load("bounce").animations[0].curve("Ball", Property.TRANSLATION)
    values, speed = np.array(path.values), 2.8
    values[:, 0] = speed * path.times_s
    ins, outs = np.array(path.in_tangents), np.array(path.out_tangents)
    ins[:, 0] = outs[:, 0] = speed
    long = Clip(
        {Channel("Ball", Property.TRANSLATION): replace(path, values=values, in_tangents=ins, out_tangents=outs)}
    )
    times = np.array([0.03, 0.2, 0.34, 0.455, 0.56, 0.68, 0.85, 1.03, 1.21, 1.385, 1.52, 1.64, 1.82, 2.0, 2.22, 2.44])
    rows: list[Any] = []
    for clip in (long, squash_and_stretch(replace(long, rate_hz=25.0), ball.skeleton, stretch=0.42, squash=0.5)):
        motions: list[Motion] = []
        for time in times:
            pose = sample_clip(clip, ball.skeleton, np.array([time]))
            roll = quat.from_axis_angle([0.0, 0, -1], np.array([3.6 * time]))
            rotations = np.array(pose.rotations)
            rotations[:, 3] = roll
            motions.append(Motion(ball.skeleton.names, replace(pose, rotations=rotations), 1.0))
        scene = Scene((ball,) * len(times), tuple(motions))
        settings = RenderSettings(
            width=1600,
            height=380,
            camera=Camera(0, 3, fov_deg=12, target=(3.42, 0.88, 0.0), distance=9.0),
            arrangement="as_is",
        )
        rows.append(render_image(scene, list(motions), 0.0, settings)[..., :3])
    Image.fromarray(np.concatenate(rows, axis=0)).save(IMAGES / "principles-bounce.jpg", quality=88, optimize=True)
    print(f"{IMAGES / 'principles-bounce.jpg'}: {(IMAGES / 'principles-bounce.jpg').stat().st_size // 1024} KB")


# --- easings --------------------------------------------------------------------------------------------------------------


def easings() -> None:
    """The catalogue: each easing in its family's colour."""
    families = ("sine", "quad", "cubic", "quart", "quint", "expo", "circ", "back", "elastic", "bounce")
    sheet = Sheet(1280, 468)
    width, height, left, top = 118, 132, 46, 46
    for column, family in enumerate(families):
        sheet.text(left + column * 123 + width / 2, 16, family, size=14, anchor="ma")
        for row, end in enumerate(("in", "out", "in_out")):
            x0, y0 = left + column * 123, top + row * 138
            sheet.panel((x0, y0, x0 + width, y0 + height))
            graph = Graph(sheet, (x0 + 16, y0 + 30, x0 + width - 16, y0 + height - 30), (0, 1), (0, 1))
            graph.levels((0, 1))
            u = np.linspace(0, 1, 400)
            color = (CORAL, BLUE, GREEN)[row]
            sheet.line(graph.at(u, ease.ease(f"{family}_{end}", u)), color, 2.4)
    for row, end in enumerate(("in", "out", "both")):
        sheet.text(left - 8, top + row * 138 + height / 2, end, FAINT, 12, "rm")
    sheet.save("principles-easings.png")


# --- moves --------------------------------------------------------------------------------------------------------------------


def moves() -> None:
    """A move and what the operators make of it: curves with their keys, and where the thing is at every frame."""
    move = Curve([0.2, 1.0, 2.4], np.array([[0.0], [1.0], [1.0]]), kind=CurveKind.SCALAR)
    soft = ease_spans(move, [0], "sine_in_out").curve
    smooth = ease_spans(move, [0], "smoothstep").curve
    shown = (
        ("two keys, linear", move),
        ("slow out, slow in", soft),
        ("anticipation", anticipate(smooth, [0], 0.2, 0.3)),
        ("overshoot and settle", overshoot(smooth, [0], 0.16)),
        ("moving hold", moving_hold(smooth, [1], 0.09)),
    )
    sheet = Sheet(1280, 300)
    for n, (title, curve) in enumerate(shown):
        x0 = 12 + n * 252
        sheet.panel((x0, 12, x0 + 244, 288), title)
        graph = Graph(sheet, (x0 + 14, 60, x0 + 230, 216), (0.0, 2.5), (-0.25, 1.25))
        graph.levels((0, 1))
        if n:
            graph.curve(move, GRID, keys=False)
        graph.curve(curve, CORAL)
        # the spacing: one ball for every frame at 12 in a second
        for time in np.arange(0, 2.5, 1 / 25):
            place = float(sample_curve(curve, time)[0])
            x = x0 + 46 + 140 * (place + 0.05)
            sheet.dot(x, 254, 7, mixed(PAPER, CORAL, 0.35), mixed(PAPER, CORAL, 0.7))
    sheet.save("principles-moves.png")


# --- follow-through ----------------------------------------------------------------------------------------------------------


def chain(count: int) -> Skeleton:
    """A body with a tail of so many joints to its left."""
    offsets = [[0.0, 0, 0]] + [[-0.24, 0, 0]] * count
    pose = Pose(offsets, np.tile([1.0, 0, 0, 0], (count + 1, 1)), np.ones((count + 1, 3)))
    return Skeleton(("body", *(f"tail{n}" for n in range(1, count + 1))), np.arange(-1, count), pose)


def follow() -> None:
    """A body that hops to the right, with a stiff tail and with one that follows through."""
    body = chain(6)
    times = [0.0, 0.45, 1.6]
    nod = quat.from_axis_angle([0.0, 0, 1], np.radians([-50.0, 35, 35]))
    clip = Clip({Channel("body", Property.ROTATION): Curve(times, nod, kind=CurveKind.ROTATION)}, rate_hz=50)
    clip = replace(clip, curves={c: ease_spans(v, [0], "cubic_in_out").curve for c, v in clip.curves.items()})
    loose = follow_through(clip, body, joints=body.names[1:], drag=1.0, frequency_hz=2.4, damping=0.3, loosen=0.86)
    sheet = Sheet(1280, 330)
    moments = (0.0, 0.14, 0.2, 0.26, 0.34, 0.44, 0.56, 0.7, 0.9, 1.4)
    for row, (title, shown) in enumerate((("stiff", clip), ("follow through", loose))):
        y0 = 10 + row * 158
        sheet.panel((12, y0, 1268, y0 + 152), title)
        for n, time in enumerate(moments):
            pose = sample_clip(shown, body, np.array([time]))
            _, places = world_rotations_positions(body, pose)
            x, y = 200 + n * 114, y0 + 76
            points = np.stack([x + 52 * places[0, :, 0], y - 52 * places[0, :, 1]], axis=-1)
            sheet.line(points, BLUE if row else FAINT, 3.2)
            for px, py in points[1:]:
                sheet.dot(px, py, 3, BLUE if row else FAINT)
            sheet.dot(x, y, 9, CORAL)
            sheet.text(x, y0 + 132, f"{time:.2f} s", FAINT, 11, "ma")
    sheet.save("principles-follow.png")


# --- arcs ----------------------------------------------------------------------------------------------------------------------


def arm() -> tuple[Skeleton, Clip]:
    """An arm of two bones that throws."""
    pose = Pose([[0, 0, 0], [1.0, 0, 0], [0.9, 0, 0]], np.tile([1.0, 0, 0, 0], (3, 1)), np.ones((3, 3)))
    skeleton = Skeleton(("shoulder", "elbow", "hand"), np.arange(-1, 2), pose)
    times = [0.0, 0.4, 0.8, 1.2]
    angles = {"shoulder": [-62.0, -38, 8, 38], "elbow": [96.0, 28, 92, 14]}
    curves = {
        Channel(joint, Property.ROTATION): Curve(
            times, quat.from_axis_angle(np.tile([0.0, 0, 1], (4, 1)), np.radians(a)), kind=CurveKind.ROTATION
        )
        for joint, a in angles.items()
    }
    return skeleton, Clip(curves, rate_hz=25)


def paths() -> None:
    """The path of a hand through four poses, with slerp and with arcs."""
    skeleton, clip = arm()
    sheet = Sheet(1000, 400)
    for n, (title, shown) in enumerate(
        (("straight in-betweens (slerp)", clip), ("arcs (squad)", arcs(clip, skeleton)))
    ):
        x0 = 12 + n * 494
        sheet.panel((x0, 12, x0 + 482, 388), title)

        def place(points: Any, x0: float = x0) -> Any:
            return np.stack([x0 + 110 + 172 * points[..., 0], 262 - 130 * points[..., 1]], axis=-1)

        def hands(times: Any, clip: Clip = shown) -> Any:
            return world_rotations_positions(skeleton, sample_clip(clip, skeleton, np.asarray(times)))[1]

        keys = [0.0, 0.4, 0.8, 1.2]
        for places in place(hands(keys)):
            sheet.line(places, GRID, 7)
            sheet.dot(*places[1], 5, GRID)
        sheet.dot(*place(np.zeros(2)), 8, FAINT)
        sheet.line(place(hands(np.linspace(0, 1.2, 600)))[:, 2], CORAL, 2.4)
        for x, y in place(hands(np.arange(0, 1.21, 0.04)))[:, 2]:
            sheet.dot(x, y, 3.2, CORAL)
        for x, y in place(hands(keys))[:, 2]:
            sheet.diamond(x, y)
    sheet.save("principles-arcs.png")


# --- stop motion ------------------------------------------------------------------------------------------------------------


def stopped() -> None:
    """A turn on ones, twos and threes, with unsteady hands."""
    turn = Clip({Channel("a", Property.ROTATION): Curve(
        [0.0, 0.8, 1.6], quat.from_axis_angle(np.tile([0.0, 0, 1], (3, 1)), np.radians([-40.0, 40, -10])), kind=CurveKind.ROTATION
    )}, rate_hz=25)  # fmt: skip
    turn = replace(turn, curves={c: ease_spans(v, [0, 1], "sine_in_out").curve for c, v in turn.curves.items()})
    sheet = Sheet(1280, 250)
    for n, (title, hold, jitter) in enumerate(
        (("on ones", 1, 0.0), ("on twos", 2, 0.0), ("on threes, unsteady", 3, 1.5))
    ):
        x0 = 12 + n * 422
        sheet.panel((x0, 12, x0 + 410, 238), title)
        graph = Graph(sheet, (x0 + 18, 50, x0 + 392, 220), (0.0, 1.6), (-48, 48))
        graph.levels((-40, 0, 40))
        at = np.linspace(0, 1.599, 1600)

        def degrees(clip: Clip, at: Any = at) -> Any:
            return np.degrees(quat.to_rotation_vector(sample_curve(clip.curves[Channel("a", Property.ROTATION)], at)))[
                :, 2
            ]

        sheet.line(graph.at(at, degrees(turn)), mixed(PAPER, FAINT, 0.6), 1.6)
        sheet.line(graph.at(at, degrees(stop_motion(turn, hold_frames=hold, jitter_deg=jitter, seed=4))), CORAL, 2.2)
    sheet.save("principles-stop-motion.png")


# --- rotation splines ---------------------------------------------------------------------------------------------------------


def rotation_curves() -> None:
    """Where an axis goes on the sphere through six keys, and how fast it turns."""
    times = np.array([0.0, 0.8, 1.3, 2.2, 3.2, 4.0])
    yaw, pitch = np.radians([-62.0, -20, 12, -8, 40, 66]), np.radians([-18.0, 28, -24, -38, 22, -12])
    keys = quat.multiply(quat.from_axis_angle([0.0, 1, 0], yaw), quat.from_axis_angle([1.0, 0, 0], pitch))
    shown: tuple[tuple[str, str, Any], ...] = (
        ("slerp", FAINT, Interpolation.LINEAR),
        ("squad", CORAL, "squad"),
        ("Shoemake's Bezier", BLUE, "spherical_bezier"),
        ("cubic in log space", GREEN, "log_cubic"),
    )
    at = np.linspace(0, 4, 1601)
    sheet = Sheet(1280, 420)
    sheet.panel((12, 12, 560, 408), "the Z axis on the sphere")
    sheet.panel((572, 12, 1268, 408), "angular speed, degrees per second")
    centre, radius = np.array([286.0, 226.0]), 168.0
    sheet.dot(*centre, radius, "#eef1f7", GRID)
    for degrees in range(-60, 61, 30):
        turn = np.linspace(-np.pi / 2, np.pi / 2, 90)
        level = np.radians(degrees)
        x, y = radius * np.cos(level) * np.sin(turn), np.full(90, radius * np.sin(level))
        sheet.line(np.stack([centre[0] + x, centre[1] - y], axis=-1), GRID, 1)
        x, y = radius * np.sin(level) * np.cos(turn), radius * np.sin(turn)
        sheet.line(np.stack([centre[0] + x, centre[1] - y], axis=-1), GRID, 1)
    graph = Graph(sheet, (620, 52, 1250, 372), (0, 4), (0, 160))
    graph.levels((0, 50, 100, 150))
    for value in (0, 50, 100, 150):
        sheet.text(612, graph.at(0, value)[1], str(value), FAINT, 11, "rm")
    for time in times:
        sheet.line(graph.at([time, time], [0, 160]), GRID, 1)
    for n, (label, color, method) in enumerate(shown):
        if isinstance(method, str):
            path = splines.interpolate(keys, times, at, method)  # pyright: ignore[reportArgumentType]
        else:
            path = sample_curve(Curve(times, keys, method, kind=CurveKind.ROTATION), at)
        tip = quat.rotate(path, [0.0, 0, 1])
        width = 5.0 if label == "squad" else 2.0  # which Shoemake's Bezier nearly covers
        sheet.line(np.stack([centre[0] + radius * tip[:, 0], centre[1] - radius * tip[:, 1]], axis=-1), color, width)
        speed = np.degrees(quat.angle_between(path[:-1], path[1:])) / np.diff(at)
        sheet.line(graph.at(at[:-1], speed), color, width)
        sheet.line([(640 + n * 150, 392), (660 + n * 150, 392)], color, 3)
        sheet.text(667 + n * 150, 392, label, size=12, anchor="lm")
    for x, y, _ in quat.rotate(keys, [0.0, 0, 1]):
        sheet.diamond(centre[0] + radius * x, centre[1] - radius * y)
    sheet.save("rotation-splines.png")


if __name__ == "__main__":
    strobe()
    easings()
    moves()
    follow()
    paths()
    stopped()
    rotation_curves()
