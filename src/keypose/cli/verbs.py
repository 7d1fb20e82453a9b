"""The verbs that change motions and bodies, with their options; each one's work is in its own module, imported when it runs."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from keypose.cli.arguments import (
    ClipOption,
    FormatOptions,
    JsonOption,
    MotionInput,
    OneInput,
    QuietOption,
    RateOption,
    RolesOption,
    SceneOutput,
    SkeletonFile,
    UnitOption,
    UpOption,
    examples,
)

verbs = typer.Typer()


@verbs.command(
    epilog=examples(
        "keypose edit walk.bvh out.bvh --reach left_hand@120=0.3,1.4,0.2",
        "keypose edit sample:walk out.glb --reach right_foot@40-60=+0,0.1,0 --ease 0.3",
        "keypose edit sample:walk circle.mp4 --loop [dim]# the straight walk round a circle, feet planted[/dim]",
        "keypose edit walk.bvh out.bvh --follow '0,0 0,1 1,2 3,2' --speed 1.2m/s",
        "keypose edit walk.bvh out.bvh --move-path 60=0.3,0 --turn-path 90 [dim]# round something, and off to the left[/dim]",
        "keypose edit walk.bvh out.bvh --reach left_hand@60=0.3,0.3,0.5 --spacetime [dim]# with the whole body[/dim]",
    )
)
def edit(
    motion: MotionInput,
    output: SceneOutput,
    reach: Annotated[
        list[str] | None,
        typer.Option(
            "--reach",
            metavar="JOINT@FRAMES=PLACE",
            help="A joint or role is at X,Y,Z metres in a frame or in frames FIRST-LAST; +X,Y,Z counts from where it is.",
        ),
    ] = None,
    turn: Annotated[
        list[str] | None,
        typer.Option("--turn", metavar="JOINT@FRAME=X,Y,Z", help="A joint turned by degrees, less and less around."),
    ] = None,
    keep: Annotated[
        list[str] | None,
        typer.Option("--keep", metavar="JOINT", help="With --turn, --whole-body and --spacetime: what stays."),
    ] = None,
    ease: Annotated[
        float | None,
        typer.Option("--ease", help="Seconds in which an edit comes and goes: 0.4, for --move-path 1.", min=0),
    ] = None,
    whole_body: Annotated[
        bool, typer.Option("--whole-body", help="Trunk and hips help where an arm or a leg is too short; feet stay.")
    ] = False,
    spacetime: Annotated[
        bool, typer.Option("--spacetime", help="Reach with the whole body, changing as little as possible; feet stay.")
    ] = False,
    bend: Annotated[float | None, typer.Option("--bend", help="Degrees that the way turns more, to the left.")] = None,
    loop: Annotated[bool, typer.Option("--loop", help="Close the way to a loop.")] = False,
    follow: Annotated[
        str | None, typer.Option("--follow", metavar="'X,Z X,Z ...'", help="A way drawn by places on the ground.")
    ] = None,
    move_path: Annotated[
        list[str] | None,
        typer.Option(
            "--move-path", metavar="FRAME=X,Z", help="The way moved by metres in a frame, and less around it."
        ),
    ] = None,
    turn_path: Annotated[
        float | None, typer.Option("--turn-path", help="Degrees by which the whole way is turned, to the left.")
    ] = None,
    stride: Annotated[float | None, typer.Option("--stride", help="How much longer steps are.", min=0.01)] = None,
    speed: Annotated[
        str | None, typer.Option("--speed", metavar="SPEED", help="A factor such as 1.5, or a speed such as 1.2m/s.")
    ] = None,
    clip: ClipOption = None,
    rate: RateOption = None,
    skeleton: SkeletonFile = None,
    option: FormatOptions = None,
    unit: UnitOption = None,
    up: UpOption = None,
    json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Edit a motion by constraints: its speed, then its path, then poses, then places to reach; frames are the result's."""
    from keypose.cli.edit import Edits, edit_file
    from keypose.cli.inputs import Reading

    edits = Edits(
        reach or (),
        turn or (),
        keep or (),
        0.4 if ease is None else ease,
        whole_body,
        spacetime,
        bend,
        loop,
        follow,
        stride,
        speed,
        move_path or (),
        turn_path,
        1.0 if ease is None else ease,
    )
    edit_file(
        motion,
        output,
        edits,
        clip=clip,
        rate_hz=rate,
        reading=Reading(unit, up, skeleton, option or ()),
        as_json=json,
        quiet=quiet,
    )


class HipsChoice(StrEnum):
    """What hips may do while feet are planted."""

    free = "free"
    upright = "upright"
    still = "still"


@verbs.command(
    epilog=examples(
        "keypose clean walk.bvh walk-clean.bvh",
        "keypose clean take.fbx clean.glb --ground slope --contacts contacts.csv",
        "keypose clean 02_01.amc clean.mp4 [dim]# look at it at once[/dim]",
        "keypose clean take.bvh clean.bvh --floor 0 [dim]# and put it on the floor[/dim]",
    )
)
def clean(
    motion: MotionInput,
    output: SceneOutput,
    clip: ClipOption = None,
    ground: Annotated[
        str, typer.Option("--ground", help="auto, flat, slope, steps, or the height under the soles in metres.")
    ] = "auto",
    hips: Annotated[
        HipsChoice, typer.Option("--hips", help="Whether hips may come along: free, upright (up and down), still.")
    ] = HipsChoice.free,
    pitch: Annotated[
        bool,
        typer.Option("--keep-pitch", help="Leave feet as they are pitched; else flat ones are laid on the ground."),
    ] = False,
    loop: Annotated[bool, typer.Option("--loop", help="The last frame is the first: keep it so.")] = False,
    floor: Annotated[
        float | None,
        typer.Option("--floor", metavar="HEIGHT", help="Lift or lower it all onto a floor there, in metres."),
    ] = None,
    contacts: Annotated[
        Path | None, typer.Option("--contacts", metavar="FILE", help="Write the contacts as .json or .csv.")
    ] = None,
    events: Annotated[
        bool, typer.Option("--events", help="Write contacts as events of the motion (.npz): left_ball.down ...")
    ] = False,
    roles: RolesOption = None,
    rate: RateOption = None,
    skeleton: SkeletonFile = None,
    option: FormatOptions = None,
    unit: UnitOption = None,
    up: UpOption = None,
    json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Hold feet still where they touch the ground, without a jump of a knee; a second time it changes nothing."""
    from keypose.cli.clean import clean_file
    from keypose.cli.inputs import Reading

    clean_file(
        motion,
        output,
        clip=clip,
        ground=ground,
        hips=hips.value,
        loop=loop,
        level_feet=not pitch,
        floor_m=floor,
        contacts=contacts,
        events=events,
        roles=roles,
        rate_hz=rate,
        reading=Reading(unit, up, skeleton, option or ()),
        as_json=json,
        quiet=quiet,
    )


@verbs.command(
    epilog=examples(
        "keypose retarget walk.bvh --to hero.glb hero-walking.glb",
        "keypose retarget 02_01.amc --to sample:human walk.mp4 [dim]# look at it at once[/dim]",
        "keypose roles hero.glb map.json && keypose retarget run.fbx --to hero.glb out.glb --to-roles map.json",
    )
)
def retarget(
    motion: MotionInput,
    output: SceneOutput,
    to: Annotated[str, typer.Option("--to", metavar="CHARACTER", help="Who is to move.", show_default=False)],
    clip: ClipOption = None,
    rate: RateOption = None,
    scale: Annotated[
        float | None, typer.Option("--scale", help="Length of the way; by leg length if not given.", min=0.001)
    ] = None,
    no_plant: Annotated[bool, typer.Option("--no-plant", help="Leave feet where the angles put them.")] = False,
    from_roles: Annotated[
        Path | None, typer.Option("--from-roles", metavar="MAP", help="Roles of the motion's joints (keypose roles).")
    ] = None,
    to_roles: Annotated[
        Path | None, typer.Option("--to-roles", metavar="MAP", help="Roles of the character's joints.")
    ] = None,
    source_reference: Annotated[
        str | None,
        typer.Option("--source-reference", metavar="FRAME", help="Frame of MOTION that stands upright; or FILE:FRAME."),
    ] = None,
    target_reference: Annotated[
        str | None,
        typer.Option(
            "--target-reference", metavar="FRAME", help="Frame of CHARACTER's motion that stands; or FILE:FRAME."
        ),
    ] = None,
    keep_hands: Annotated[
        bool, typer.Option("--keep-hands", help="Hands that touch body or props do so on the character.")
    ] = False,
    prop: Annotated[
        list[str] | None,
        typer.Option("--prop", metavar="X,Y,Z", help="A place that hands hold on to, in metres; X,Y,Z:X,Y,Z for two."),
    ] = None,
    against: Annotated[
        str | None, typer.Option("--against", metavar="FILE", help="Somebody else's result, to be compared.")
    ] = None,
    skeleton: SkeletonFile = None,
    option: FormatOptions = None,
    unit: UnitOption = None,
    up: UpOption = None,
    json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Put a motion on another character, feet planted, and print how well it fits."""
    from keypose.cli.inputs import Reading
    from keypose.cli.retarget import RetargetAsked, retarget_file

    references, maps = (source_reference, target_reference), (from_roles, to_roles)
    asked = RetargetAsked(scale, not no_plant, *maps, *references, keep_hands, prop or (), against)
    retarget_file(
        motion,
        to,
        output,
        asked,
        clip=clip,
        rate_hz=rate,
        reading=Reading(unit, up, skeleton, option or ()),
        as_json=json,
        quiet=quiet,
    )


@verbs.command(
    epilog=examples(
        "keypose rig hero.glb [dim]# its controls[/dim]",
        "keypose rig hero.glb hero.keypose [dim]# a project to pose and key them in: keypose studio hero.keypose[/dim]",
        "keypose rig sample:human walk.keypose --motion sample:walk [dim]# a motion as keys on controls[/dim]",
        "keypose convert walk.keypose walk.glb [dim]# and back to joints[/dim]",
    )
)
def rig(
    character: Annotated[
        str,
        typer.Argument(
            metavar="CHARACTER", help="A file with a human or an animal, or sample:NAME.", show_default=False
        ),
    ],
    output: Annotated[
        Path | None, typer.Argument(metavar="OUT", help="The project to write, OUT.keypose.", show_default=False)
    ] = None,
    motion: Annotated[
        str | None,
        typer.Option("--motion", metavar="FILE", help="A motion to be keyed on the controls; retargeted where needed."),
    ] = None,
    clip: ClipOption = None,
    rate: Annotated[float | None, typer.Option("--rate", help="Keys per second of the motion.", min=0.001)] = None,
    roles: RolesOption = None,
    skeleton: SkeletonFile = None,
    option: FormatOptions = None,
    unit: UnitOption = None,
    up: UpOption = None,
    json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Rig a human or an animal: FK and IK controls, foot roll, look-at, fingers; list them, or write a project."""
    from keypose.cli.inputs import Reading
    from keypose.cli.rig import rig_file

    if motion is None:
        for name, given in (("--rate", rate), ("--clip", clip), ("--skeleton", skeleton), ("--option", option)):
            if given is not None:
                raise typer.BadParameter("goes with a --motion", param_hint=name)
    elif output is None:
        raise typer.BadParameter("goes with an OUT, which keeps its keys", param_hint="--motion")

    rig_file(
        character,
        output,
        motion=motion,
        clip=clip,
        rate_hz=rate,
        roles=roles,
        reading=Reading(unit, up, skeleton, option or ()),
        as_json=json,
        quiet=quiet,
    )


@verbs.command(
    epilog=examples("keypose roles hero.fbx", "keypose roles hero.fbx map.json [dim]# correct it by hand[/dim]")
)
def roles(
    file: OneInput,
    output: Annotated[
        Path | None, typer.Argument(metavar="MAP", help="Write the map as JSON.", show_default=False)
    ] = None,
    json: JsonOption = False,
    skeleton: SkeletonFile = None,
    option: FormatOptions = None,
    unit: UnitOption = None,
    up: UpOption = None,
) -> None:
    """Say which joint plays which role in the body, of a human or an animal; exit code 1 where some that it needs are missing."""
    from keypose.cli.inputs import Reading
    from keypose.cli.roles import print_roles

    if not print_roles(file, output, reading=Reading(unit, up, skeleton, option or ()), as_json=json):
        raise typer.Exit(1)


@verbs.command(
    epilog=examples(
        "keypose skin statue.obj --skeleton walk.bvh hero.glb [dim]# the skeleton's rest pose has to fit the mesh[/dim]",
        "keypose skin hero.fbx hero.glb [dim]# new weights for a character as it is[/dim]",
        "keypose skin hero.glb hero-8.glb --influences 8 --strength 0.5 [dim]# wider, softer bends[/dim]",
        "keypose skin hero.glb running.png --clip Run [dim]# look at it at once[/dim]",
    )
)
def skin(
    mesh: Annotated[
        str, typer.Argument(metavar="MESH", help="A file with a mesh, or sample:NAME.", show_default=False)
    ],
    output: SceneOutput,
    skeleton: Annotated[
        str | None,
        typer.Option("--skeleton", metavar="FILE", help="Whose skeleton and motions; the mesh's own if not given."),
    ] = None,
    joints: Annotated[
        str | None, typer.Option("--joints", metavar="NAMES", help="Joints that may move something, with commas.")
    ] = None,
    influences: Annotated[
        int, typer.Option("--influences", help="Joints that may move a vertex, at most.", min=1, max=64)
    ] = 4,
    strength: Annotated[
        float, typer.Option("--strength", help="Narrower (above 1) or wider (below 1) bends.", min=0.01, max=100)
    ] = 1.0,
    dual_quaternion: Annotated[
        bool, typer.Option("--dual-quaternion", help="Blend with dual quaternions, which keep volume in twists.")
    ] = False,
    clip: Annotated[str | None, typer.Option("--clip", help="Name of the animation to keep; all if not given.")] = None,
    json: JsonOption = False,
    unit: UnitOption = None,
    up: UpOption = None,
    option: FormatOptions = None,
    quiet: QuietOption = False,
) -> None:
    """Bind a mesh to a skeleton with automatic weights, and print how they came about."""
    from keypose.cli.inputs import Reading
    from keypose.cli.weights import skin_file

    skin_file(
        mesh,
        output,
        skeleton=skeleton,
        joints=None if joints is None else [name.strip() for name in joints.split(",") if name.strip()],
        influences=influences,
        strength=strength,
        dual_quaternion=dual_quaternion,
        clip=clip,
        reading=Reading(unit, up, options=option or ()),
        as_json=json,
        quiet=quiet,
    )
