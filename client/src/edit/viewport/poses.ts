// Poses as things: taken from the character, put away, put on again, mirrored, half and half.

import type { Actor } from "../../view/actor";
import { channelOf, type Editor, type StoredPose } from "../contract";
import { rigging } from "../rig/rigging.svelte";
import { mirrorOf, type StoredJoint } from "./mirror";
import { between, type Quat } from "./spaces";

/** What a pose of the whole character holds: with a rig, its controls, and the joints that they leave alone. */
function ownJoints({ rig }: Actor): number[] {
  const moved = new Set(rig.count > rig.jointCount ? rigging.active?.modules.flatMap((m) => m.joints) : []);
  return [...rig.names.keys()].filter((joint) => joint >= rig.jointCount || !moved.has(rig.names[joint]));
}

/** What the joints show now; of a pose of the whole character also the morphs. */
export function takePose(actor: Actor, name: string, joints: readonly number[] | null): StoredPose {
  const { rig, morphNames } = actor, { pose } = rig;
  const out: Record<string, StoredJoint> = {};
  for (const joint of joints ?? ownJoints(actor))
    out[rig.names[joint]] = {
      translation: [...pose.translations.subarray(3 * joint, 3 * joint + 3)],
      rotation: [...pose.rotations.subarray(4 * joint, 4 * joint + 4)],
      scale: [...pose.scales.subarray(3 * joint, 3 * joint + 3)],
    };
  const morphs = joints ? {} : Object.fromEntries(morphNames.map((m, n) => [m, pose.morphs[n]]));
  return { name, joints: out, morphs };
}

export const mirrored = (actor: Actor, pose: StoredPose): StoredPose => mirrorOf(actor.rig, actor.morphNames).pose(pose);

/** Joints of a pose that the character has. */
export function fitting(actor: Actor, pose: StoredPose): number[] {
  return Object.keys(pose.joints).map((name) => actor.rig.index(name)).filter((joint) => joint >= 0);
}

const SAME = 1e-9;

/**
 * The values that bring a pose nearer to a stored one, by channel: share 0 leaves it, 1 is the stored pose. What stays as
 * it is does not appear, so that it gets no keys.
 */
export function posedValues(actor: Actor, from: StoredPose, to: StoredPose, share: number, only: ReadonlySet<number> | null): Map<string, readonly number[]> {
  const out = new Map<string, readonly number[]>();
  const { rig } = actor;
  const differs = (a: readonly number[], b: readonly number[]) => a.some((v, n) => Math.abs(v - b[n]) > SAME);
  for (const [name, goal] of Object.entries(to.joints)) {
    const joint = rig.index(name), now = from.joints[name];
    if (joint < 0 || !now || (only && !only.has(joint))) continue;
    const mix = (a: readonly number[], b: readonly number[]) => a.map((v, n) => v + share * (b[n] - v));
    if (differs(now.translation, goal.translation)) out.set(channelOf(name, "translation").key, mix(now.translation, goal.translation));
    if (differs(now.scale, goal.scale)) out.set(channelOf(name, "scale").key, mix(now.scale, goal.scale));
    const a = now.rotation as unknown as Quat, b = goal.rotation as unknown as Quat;
    if (Math.abs(Math.abs(a.reduce((sum, v, n) => sum + v * b[n], 0)) - 1) > 1e-14) out.set(channelOf(name, "rotation").key, share === 1 ? b : between(a, b, share));
  }
  if (!only)
    for (const [name, weight] of Object.entries(to.morphs)) {
      const now = from.morphs[name];
      if (now !== undefined && Math.abs(now - weight) > SAME) out.set(channelOf(name, "weight").key, [now + share * (weight - now)]);
    }
  return out;
}

/** One application of a pose, from the first touch of a slider to its release. */
export class Blend {
  private readonly from: StoredPose;
  private readonly before: Editor["posed"];

  constructor(
    private readonly editor: Editor,
    private readonly actor: Actor,
    private readonly pose: StoredPose,
    private readonly only: ReadonlySet<number> | null,
  ) {
    actor.evaluate(editor.time);
    this.from = { ...takePose(actor, "", null), joints: takePose(actor, "", [...actor.rig.names.keys()]).joints };
    this.before = editor.posed;
  }

  set(share: number, done = false): void {
    const values = posedValues(this.actor, this.from, this.pose, share, this.only);
    if (values.size === 0) return;
    this.editor.pose(values, `Pose “${this.pose.name}”${share < 1 ? ` by ${Math.round(100 * share)} %` : ""}`, done);
  }

  cancel(): void {
    if (this.editor.autoKey) this.editor.preview(null);
    else this.editor.posed = this.before;
  }
}

/** What Ctrl+C took, for Ctrl+V on this or another character. */
class Clipboard {
  pose: StoredPose | null = null;
}
export const clipboard = new Clipboard();

export function copyPose(editor: Editor): void {
  const { actor } = editor;
  if (!actor) return;
  const joints = editor.selectedJoints;
  clipboard.pose = takePose(actor, "copied", joints.length > 0 ? joints : null);
  const what = joints.length === 0 ? "the whole pose" : joints.length === 1 ? actor.rig.names[joints[0]] : `${joints.length} joints`;
  editor.toast("info", "Pose copied", `${what}: Ctrl+V pastes, Ctrl+Shift+V pastes its mirror image.`);
}

export function pastePose(editor: Editor, flipped: boolean): void {
  const { actor } = editor, { pose } = clipboard;
  if (!actor || !pose) return;
  const put = flipped ? mirrored(actor, pose) : pose;
  if (fitting(actor, put).length === 0) {
    editor.toast("info", "Nothing to paste", flipped ? "The copied joints have no other side." : "This character has none of the copied joints.");
    return;
  }
  new Blend(editor, actor, { ...put, name: flipped ? "pasted mirrored" : "pasted" }, null).set(1, true);
}

/** A free name in the library. */
export function poseName(poses: ReadonlyMap<string, StoredPose>, wanted: string): string {
  if (!poses.has(wanted)) return wanted;
  for (let n = 2; ; n++) if (!poses.has(`${wanted} ${n}`)) return `${wanted} ${n}`;
}
