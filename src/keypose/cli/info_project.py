"""What `keypose info` says of a project."""

from __future__ import annotations

from typing import Any

from keypose.cli.console import counted


def print_project(out: Any, project: dict[str, Any]) -> None:
    """Clips with their keys, timelines and who performs them, poses, rigs."""
    from rich.markup import escape

    out.print(
        f"  project [bold]{escape(project['name'] or '(unnamed)')}[/bold] [dim](version {project['version']})[/dim]"
    )
    for clip in project["clips"]:
        keys = f"{counted(clip['curves'], 'curve')}, {counted(clip['keys'], 'key')}"
        out.print(f"    clip {escape(clip['name'])}: {keys}")
    for track in project["timelines"]:
        who = [c["name"] for c in project["characters"] if c["timeline"] == track["name"]]
        moves = f", moves {escape(', '.join(who))}" if who else ""
        out.print(
            f"    timeline {escape(track['name'])}: {counted(track['layers'], 'layer')}, "
            f"{counted(track['placements'], 'placed clip')}, {track['start_s']:.6g} to {track['end_s']:.6g} s "
            f"at {track['rate_hz']:.6g} Hz{moves}"
        )
    if project["poses"]:
        out.print(f"    {counted(len(project['poses']), 'pose')}: {escape(', '.join(project['poses'][:24]))}")
    for rig in project["rigs"]:
        out.print(f"    rig {escape(rig['name'])}: {counted(rig['controls'], 'control')} of {escape(rig['character'])}")
