// What the 3D view can be asked for: entries of the command palette and both key maps.

import * as THREE from "three";
import { studio } from "../../studio.svelte";
import type { Command } from "../commands";
import { channelOf, type ChannelId, type Editor, type Property } from "../contract";
import { rigging } from "../rig/rigging.svelte";
import type { Mode } from "./manipulate";
import { Blend, clipboard, copyPose, mirrored, pastePose, takePose } from "./poses";
import type { StageEditor } from "./stage-editor";
import { mirrorOf } from "./mirror";
import { SPACES, TOOLS, tools, type Tool } from "./tools.svelte";

const TURN = Math.PI / 12;

export function viewCommands(editor: Editor, stage: StageEditor): Command[] {
  const { view } = stage;
  const area = "viewport" as const;
  const some = () => stage.joints.length > 0;
  const present = () => editor.actor !== null;
  const command = (id: string, label: string, group: string, blender: string, maya: string, run: () => void, when: () => boolean = present): Command => ({
    id: `view.${id}`,
    label,
    group,
    blender,
    maya,
    area,
    when,
    run,
  });
  const begin = (mode: Mode) => () => stage.begin(mode);
  const look = (x: number, y: number, z: number) => () => {
    tools.lookThrough = false;
    view.orbit.lookAlong(new THREE.Vector3(x, y, z));
    view.invalidate();
  };
  const pick = (tool: Tool) => () => (tools.tool = tool);
  const rig = () => editor.actor!.rig;
  const selectAll = (joints: readonly number[]) => (editor.selectedJoints = joints);

  return [
    command("move", "Move joints", "Pose", "G", "", begin("move"), some),
    command("rotate", "Rotate joints", "Pose", "R", "", begin("rotate"), some),
    command("scale", "Scale joints", "Pose", "S", "", begin("scale"), some),
    command("tool.select", "Tool: select", "Pose", "Q", "Q", pick("select")),
    command("tool.move", "Tool: move", "Pose", "W", "W", pick("move")),
    command("tool.rotate", "Tool: rotate", "Pose", "E", "E", pick("rotate")),
    command("tool.scale", "Tool: scale", "Pose", "Shift+E", "R", pick("scale")),
    command("space", "Next orientation: local, parent, global", "Pose", "Shift+O", "Shift+O", () => (tools.space = SPACES[(SPACES.indexOf(tools.space) + 1) % SPACES.length])),
    command("pivot", "Turn each about itself, or all about one point", "Pose", "Shift+P", "Shift+P", () => (tools.turns = tools.turns === "common" ? "individual" : "common")),
    command("detach", "Move any joint, not only roots", "Pose", "", "", () => (tools.detach = !tools.detach)),
    command("clear.rotation", "Clear rotation", "Pose", "Alt+R", "", () => toRest(editor, stage, ["rotation"]), some),
    command("clear.translation", "Clear location", "Pose", "Alt+G", "", () => toRest(editor, stage, ["translation"]), some),
    command("clear.scale", "Clear scale", "Pose", "Alt+S", "", () => toRest(editor, stage, ["scale"]), some),
    command("key", "Key what was changed by hand", "Pose", "K", "", () => keyShown(editor, stage), () => some() || editor.posed.size > 0),
    command("drop", "Forget what is posed and not keyed", "Pose", "", "", () => editor.dropPosed(), () => editor.posed.size > 0),
    command("copy", "Copy pose", "Pose", "Ctrl+C", "Ctrl+C", () => copyPose(editor)),
    command("paste", "Paste pose", "Pose", "Ctrl+V", "Ctrl+V", () => pastePose(editor, false), () => present() && clipboard.pose !== null),
    command("paste.mirrored", "Paste pose mirrored", "Pose", "Ctrl+Shift+V", "Ctrl+Shift+V", () => pastePose(editor, true), () => present() && clipboard.pose !== null),
    command("flip", "Mirror the whole pose", "Pose", "", "", () => flip(editor)),

    command("select.invert", "Select the other joints", "Select", "Ctrl+I", "Ctrl+Shift+I", () => selectAll([...rig().names.keys()].filter((j) => !stage.joints.includes(j)))),
    command("select.below", "Select all below", "Select", "Shift+G", "", () => selectAll(below(rig().children, stage.joints)), some),
    command("select.mirror", "Select the other side", "Select", "Ctrl+Shift+M", "", () => selectAll(otherSide(editor, stage)), some),
    command("select.box", "Select by a rectangle", "Select", "B", "", () => (tools.boxArmed = true)),

    command("frame", "Frame the selected joints", "View", "NumpadDecimal F", "F", () => frameSelected(editor, stage)),
    command("frame.all", "Frame everything", "View", "Home", "A", () => view.frameAll()),
    command("front", "Front view", "View", "Numpad1", "", look(0, 0, 1)),
    command("back", "Back view", "View", "Ctrl+Numpad1", "", look(0, 0, -1)),
    command("right", "View of the character's left side", "View", "Numpad3", "", look(1, 0, 0)),
    command("left", "View of the character's right side", "View", "Ctrl+Numpad3", "", look(-1, 0, 0)),
    command("top", "Top view", "View", "Numpad7", "", look(0, 1, 1e-6)),
    command("bottom", "Bottom view", "View", "Ctrl+Numpad7", "", look(0, -1, 1e-6)),
    command("parallel", "Parallel or perspective", "View", "Numpad5", "", () => {
      view.orbit.setParallel(!view.orbit.isParallel);
      view.invalidate();
    }),
    command("turn.left", "Turn the view to the left", "View", "Numpad4", "", () => (view.orbit.turn(-TURN, 0), view.invalidate())),
    command("turn.right", "Turn the view to the right", "View", "Numpad6", "", () => (view.orbit.turn(TURN, 0), view.invalidate())),
    command("turn.up", "Turn the view up", "View", "Numpad8", "", () => (view.orbit.turn(0, -TURN), view.invalidate())),
    command("turn.down", "Turn the view down", "View", "Numpad2", "", () => (view.orbit.turn(0, TURN), view.invalidate())),
    command("through", "Look through the active joint", "View", "Numpad0", "", () => ((tools.lookThrough = !tools.lookThrough), view.invalidate()), () => some() || tools.lookThrough),
    command("surface", "Next display: shaded, wire, skeleton", "View", "Z", "", () => (tools.surface = tools.surface === "shaded" ? "wire" : tools.surface === "wire" ? "none" : "shaded")),
    command("bones", "Show bones", "View", "Shift+B", "Shift+B", () => (tools.bones = !tools.bones)),
    command("axes", "Show the axes of all joints", "View", "Shift+X", "", () => (tools.axes = !tools.axes)),
    command("paths", "Show motion paths", "View", "Shift+M", "Shift+M", () => (tools.paths = !tools.paths)),
    command("paths.pin", "Keep the paths of the selected joints", "View", "", "", () => ((tools.pinned = [...stage.joints]), (tools.paths = true)), some),
    command("paths.free", "Paths follow the selection", "View", "", "", () => (tools.pinned = []), () => tools.pinned.length > 0),
    command("ghosts", "Show ghosts", "View", "Shift+H", "Shift+H", () => (tools.ghosts = !tools.ghosts)),
    command("playblast", "Playblast: a film of the view…", "View", "", "", () => (tools.playblast = true), () => present() && editor.timeline !== null),
    command("tool.next", "Next tool", "Pose", "", "", () => (tools.tool = TOOLS[(TOOLS.indexOf(tools.tool) + 1) % TOOLS.length])),
  ];
}

/** The joints and all that hang on them, the given ones first. */
function below(children: number[][], joints: readonly number[]): number[] {
  const out = [...joints], seen = new Set(out);
  for (let n = 0; n < out.length; n++)
    for (const child of children[out[n]])
      if (!seen.has(child)) {
        seen.add(child);
        out.push(child);
      }
  return out;
}

function otherSide(editor: Editor, stage: StageEditor): number[] {
  const { rig, morphNames } = editor.actor!;
  const mirror = mirrorOf(rig, morphNames);
  return stage.joints.flatMap((j) => {
    const other = mirror.other(rig.names[j]);
    return other === null ? [] : [rig.index(other)];
  });
}

/** Local values of the selected joints back to rest. */
function toRest(editor: Editor, stage: StageEditor, properties: ("translation" | "rotation" | "scale")[]): void {
  const actor = editor.actor!, { rig } = actor;
  actor.evaluate(editor.time);
  const kept = takePose(actor, "", stage.joints);
  const goal = structuredClone(kept);
  for (const joint of stage.joints) {
    const local = goal.joints[rig.names[joint]];
    for (const property of properties) {
      const width = property === "rotation" ? 4 : 3;
      local[property] = [...rig.rest[`${property}s`].subarray(width * joint, width * (joint + 1))];
    }
  }
  new Blend(editor, actor, { ...goal, name: "at rest" }, null).set(1, true);
}

/** Key what was set by hand; where nothing was, what the selected joints show. */
export function keyShown(editor: Editor, stage: StageEditor): void {
  const actor = editor.actor!, { rig } = actor;
  const byHand = new Map<Property, number[]>(), numbers: ChannelId[] = [];
  for (const key of editor.posed.keys()) {
    const [target, property] = key.split("\u0000") as [string, Property];
    if (property === "weight" || property === "value") numbers.push(channelOf(target, property));
    const joint = rig.index(target);
    if (joint >= 0) byHand.set(property, [...(byHand.get(property) ?? []), joint]);
  }
  const properties = new Set<Property>(["rotation", ...byHand.keys()]);
  const joints = [...new Set([...stage.joints, ...[...byHand.values()].flat()])];
  // roots move, and so does what was moved once
  if (joints.some((j) => rig.parents[j] < 0 || byHand.get("translation")?.includes(j) || tools.detach)) properties.add("translation");
  for (const curve of editor.clip?.curves.values() ?? [])
    if (curve.channel.property === "scale" && joints.some((j) => rig.names[j] === curve.channel.target)) properties.add("scale");
  editor.insertKeys(joints, [...properties], numbers);
}

function flip(editor: Editor): void {
  if (rigging.active) return void rigging.mirror();
  const actor = editor.actor!;
  actor.evaluate(editor.time);
  new Blend(editor, actor, { ...mirrored(actor, takePose(actor, "", null)), name: "mirrored" }, null).set(1, true);
}

/** The selected joints and what hangs on them at once; the whole character where none is. */
export function frameSelected(editor: Editor, stage: StageEditor): void {
  const { view } = stage, { actor } = editor;
  if (!actor || stage.joints.length === 0) {
    studio.view.frameAll();
    return;
  }
  const box = new THREE.Box3(), point = new THREE.Vector3();
  for (const joint of stage.joints)
    for (const j of [joint, ...actor.rig.children[joint]]) box.expandByPoint(actor.toStage(actor.jointPosition(j, point)));
  view.orbit.frame(box.expandByScalar(0.12 * actor.height * actor.scale), null);
  view.invalidate();
}
