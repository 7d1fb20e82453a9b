"""`keypose info`: what a file holds."""

from __future__ import annotations

import math
from typing import Any

from keypose.cli.console import console, counted
from keypose.cli.info_project import print_project
from keypose.cli.inputs import AS_THEY_SAY, Reading, open_input
from keypose.cli.output import print_json
from keypose.model import Clip, Motion, Scene


def describe(scene: Scene) -> dict[str, Any]:
    """The object that `info --json` prints; keys that do not apply are null or empty."""
    from keypose.evaluate import key_rate
    from keypose.io.axes import unit_name

    clips: list[dict[str, Any]] = []
    for animation in scene.animations:
        if isinstance(animation, Motion):
            frames, rate = animation.frame_count, animation.rate_hz
        else:
            rate = key_rate(animation)
            frames = round(animation.duration_s * rate) + 1 if rate else None
        clips.append({"name": animation.name, "frames": frames, "rate_hz": rate, "duration_s": animation.duration_s})
    names = [name for c in scene.characters for name in c.skeleton.names]
    morphs = [name for c in scene.characters for name in c.morph_names]
    if not scene.characters and scene.animations and isinstance(scene.animations[0], Motion):
        morphs = list(scene.animations[0].morph_names)  # a take of a face alone
    first: dict[str, Any] = {"frames": None, "rate_hz": None, "duration_s": None}
    if clips:
        first = clips[0]
    elif scene.markers:
        markers = scene.markers[0]
        first = {"frames": markers.frame_count, "rate_hz": markers.rate_hz, "duration_s": markers.duration_s}
    marker_names = [name for m in scene.markers for name in m.names]
    return {
        "format": scene.format,
        "unit": unit_name(scene.unit_m),
        "up": scene.up,
        "joints": len(names),
        "joint_names": names,
        "frames": first["frames"],
        "rate_hz": first["rate_hz"],
        "duration_s": first["duration_s"],
        "markers": len(marker_names) if scene.markers else None,
        "marker_names": marker_names,
        "meshes": sum(len(c.parts) for c in scene.characters),
        "vertices": sum(c.vertex_count for c in scene.characters),
        "triangles": sum(c.triangle_count for c in scene.characters),
        "morphs": len(morphs),
        "morph_names": morphs,
        "clips": clips,
        "notes": list(scene.notes),
        **({"project": scene.extras["project"]} if "project" in scene.extras else {}),
    }


def print_info(reference: str, *, reading: Reading = AS_THEY_SAY, as_json: bool = False) -> None:
    """Print what a file holds, for people or as JSON."""
    scene = open_input(reference, reading)
    facts = describe(scene)
    if as_json:
        print_json(facts)
        return
    from rich.markup import escape
    from rich.table import Table

    out = console()
    out.print(f"[bold]{escape(reference)}[/bold]  [dim]{facts['format']}, unit {facts['unit']}, {facts['up']} up[/dim]")
    for character in scene.characters:
        out.print(f"  {escape(character.name or 'character')}: {_summary(character)}")
        _print_tree(out, character.skeleton)
    if facts["clips"]:
        table = Table(box=None, pad_edge=False, padding=(0, 3, 0, 0), header_style="dim")
        for title, side in (
            ("  clip", "left"),
            ("frames", "right"),
            ("rate", "right"),
            ("seconds", "right"),
            ("channels", "right"),
        ):
            table.add_column(title, justify=side)  # pyright: ignore[reportArgumentType]
        for animation, clip in zip(scene.animations, facts["clips"], strict=True):
            if isinstance(animation, Clip):
                channels = counted(len(animation.curves), "curve")
            else:
                weights = [counted(len(animation.morph_names), "weight")] if animation.morph_names else []
                joints = [counted(len(animation.joint_names), "joint")] if animation.joint_names or not weights else []
                channels = ", ".join(joints + weights)
            table.add_row(
                f"  {escape(clip['name'] or '(unnamed)')}",
                "—" if clip["frames"] is None else f"{clip['frames']:,}",
                "keys" if clip["rate_hz"] is None else f"{clip['rate_hz']:.6g} Hz",
                f"{clip['duration_s']:.3f}",
                channels,
            )
        out.print(table)
    _print_capture(out, scene)
    if "project" in scene.extras:
        print_project(out, scene.extras["project"])
    for tier in scene.tiers:
        kind = "point" if tier.is_points else "interval"
        spoken = " ".join(label for label in tier.labels if label)
        out.print(
            f"  {escape(tier.name or 'tier')}: {counted(len(tier.labels), kind)}, {tier.start_s:.3f} to {tier.end_s:.3f} s"
        )
        out.print(f"    [dim]{escape(spoken[:100] + ('…' if len(spoken) > 100 else ''))}[/dim]")
    for note in scene.notes:
        out.print(f"  [yellow]note[/yellow] {escape(note)}")


def _print_capture(out: Any, scene: Scene) -> None:
    """Markers, signals, plates and events: what a lab recorded."""
    from rich.markup import escape

    for markers in scene.markers:
        missing = 1 - float(markers.visible.mean()) if markers.visible is not None and markers.visible.size else 0.0
        last = markers.start_frame + markers.frame_count - 1
        out.print(
            f"  {escape(markers.name or 'markers')}: {counted(len(markers.names), 'marker')}, "
            f"{counted(markers.frame_count, 'frame')} ({markers.start_frame} to {last}) at {markers.rate_hz:.6g} Hz, "
            f"{markers.duration_s:.3f} s, {100 * missing:.1f}% missing"
        )
        out.print(f"    [dim]{escape(_names(markers.names))}[/dim]")
    for signals in scene.signals:
        units = "/".join(dict.fromkeys(filter(None, signals.units)))
        kind = "analog channel" if signals.kind == "analog" else f"{signals.kind} signal"
        out.print(
            f"  {counted(len(signals.names), kind)} at {signals.rate_hz:.6g} Hz{f' in {escape(units)}' if units else ''}"
        )
        out.print(f"    [dim]{escape(_names(signals.names))}[/dim]")
    if scene.plates:
        sizes: list[str] = []
        for plate in scene.plates:
            a, b, c = (tuple(map(float, plate.corners[i])) for i in range(3))
            sizes.append(f"{math.dist(a, b):.2f} x {math.dist(b, c):.2f} m (type {plate.kind})")
        out.print(f"  {counted(len(scene.plates), 'force plate')}: {', '.join(sizes)}")
    events = scene.extras.get("events", ())
    if events:
        out.print(f"  {counted(len(events), 'event')}")


def _names(names: tuple[str, ...], limit: int = 24) -> str:
    shown = " · ".join(names[:limit])
    return shown if len(names) <= limit else f"{shown} … +{len(names) - limit}"


def _summary(character: Any) -> str:
    pieces = [counted(character.skeleton.joint_count, "joint")]
    if character.parts:
        pieces += [
            counted(len(character.parts), "mesh part"),
            counted(character.vertex_count, "vertex", "vertices"),
            counted(character.triangle_count, "triangle"),
        ]
    if character.morph_names:
        pieces.append(counted(len(character.morph_names), "morph"))
    return ", ".join(pieces)


def _print_tree(out: Any, skeleton: Any, limit: int = 16) -> None:
    """The first levels of the hierarchy: enough to recognise a rig, short enough to read."""
    from rich.markup import escape
    from rich.tree import Tree

    children: dict[int, list[int]] = {}
    for joint, parent in enumerate(skeleton.parents.tolist()):
        children.setdefault(parent, []).append(joint)
    shown, level, queue = set[int](), 0, list(children.get(-1, []))
    while (queue and len(shown) + len(queue) <= limit) or level == 0:
        shown.update(queue)
        queue = [c for j in queue for c in children.get(j, [])]
        level += 1
        if not queue:
            break

    def grow(tree: Tree, joint: int) -> None:
        branch = tree.add(escape(skeleton.names[joint]))
        hidden = 0
        for child in children.get(joint, []):
            if child in shown:
                grow(branch, child)
            else:
                hidden += _count(children, child)
        if hidden:
            branch.add(f"[dim]+{hidden}[/dim]")

    tree = Tree("", hide_root=True, guide_style="dim")
    for root in children.get(-1, []):
        if root in shown:
            grow(tree, root)
    from rich.padding import Padding

    out.print(Padding(tree, (0, 0, 0, 2)))


def _count(children: dict[int, list[int]], joint: int) -> int:
    count, queue = 0, [joint]
    while queue:
        count += 1
        queue.extend(children.get(queue.pop(), []))
    return count
