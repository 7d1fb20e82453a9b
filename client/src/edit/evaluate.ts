// The document drives its characters: what is shown now, without the muted curves, and over it what was set by hand.

import { Animation, type Binding } from "../anim/animation";
import type { Pose, Rig } from "../anim/rig";
import { bindTimeline } from "../anim/timeline";
import type { ClipData } from "../generated/messages";
import type { Actor } from "../view/actor";
import type { EditClip, EditDocument, EditTimeline } from "./contract";
import { keyTimes } from "./document";
import { localOf } from "./posing";

/** The document without some curves of one clip. */
export function without(document: EditDocument, clip: EditClip | null, muted: ReadonlySet<string>): EditDocument {
  if (!clip || muted.size === 0 || ![...muted].some((key) => clip.curves.has(key))) return document;
  const curves = new Map([...clip.curves].filter(([key]) => !muted.has(key)));
  return { ...document, clips: new Map(document.clips).set(clip.name, { ...clip, curves }) };
}

/** A timeline as an animation of the stage. */
export class TimelineAnimation extends Animation {
  readonly kind = "clip";

  constructor(
    private readonly document: EditDocument,
    readonly timeline: EditTimeline,
    sceneId: string,
    /** Has the last word on every pose. */
    private readonly over: (time: number, pose: Pose) => void,
  ) {
    const { name, start, end, rate } = timeline;
    const data: ClipData = { kind: "clip", name, start_s: start, duration_s: end - start, rate_hz: rate, curves: [], euler_orders: {} };
    super(data, sceneId, 0);
  }

  private clips(): EditClip[] {
    const names = new Set(this.timeline.layers.flatMap((l) => l.placements.map((p) => p.animation)));
    return [...names].flatMap((name) => this.document.clips.get(name) ?? []);
  }

  private targets(morphs: boolean): ReadonlySet<string> {
    const own = this.clips().flatMap((clip) => [...clip.curves.values()].map((c) => c.channel));
    return new Set(own.filter((c) => (c.property === "weight") === morphs && c.property !== "value").map((c) => c.target));
  }

  get joints(): ReadonlySet<string> {
    return this.targets(false);
  }

  get morphNames(): ReadonlySet<string> {
    return this.targets(true);
  }

  bind(rig: Rig, morphNames: string[]): Binding {
    const bound = bindTimeline(this.document, this.timeline.name, rig, morphNames)!;
    const { over } = this;
    return {
      morphs: bound.morphs,
      apply(time, pose) {
        bound.apply(time, pose);
        over(time, pose);
      },
    };
  }

  keyTimes(rig: Rig, joint: number | null): Float64Array {
    const curves = this.clips().flatMap((clip) => [...clip.curves.values()]);
    return keyTimes(joint === null ? curves : curves.filter((c) => c.channel.target === rig.names[joint]));
  }
}

/** Whether keys of a layer are what is shown: nothing lies over or under it that counts. */
function alone(timeline: EditTimeline, layer: string): boolean {
  const open = timeline.layers.filter((l) => !l.muted);
  const heard = open.some((l) => l.solo) ? open.filter((l) => l.solo) : open;
  const own = heard[0];
  if (heard.length !== 1 || own.name !== layer) return false;
  return own.mode === "replace" && own.influence === 1 && own.placements.length === 1 && own.placements[0].weight === null;
}

/**
 * The local values that a layer must give so that the pose in the rig is what the whole timeline gives, by joint; and
 * whether it can.
 */
export function layerValues(
  document: EditDocument,
  timeline: EditTimeline,
  layer: string,
  actor: Actor,
  time: number,
): (joint: number) => { translation: number[]; rotation: number[]; scale: number[]; possible: boolean } {
  const { rig, morphNames } = actor;
  const wanted = (joint: number) => ({
    translation: localOf(rig.pose, joint, "translation"),
    rotation: localOf(rig.pose, joint, "rotation"),
    scale: localOf(rig.pose, joint, "scale"),
  });
  if (alone(timeline, layer)) return (joint) => ({ ...wanted(joint), possible: true });
  const bound = bindTimeline(document, timeline.name, rig, morphNames);
  return (joint) => {
    const found = bound!.valueForResult(layer, time, joint, wanted(joint));
    const { translation, rotation, scale } = found.reachable;
    return { ...found, possible: translation && rotation && scale };
  };
}
