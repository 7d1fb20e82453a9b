// Dragging a key of a motion path: the joint is put elsewhere at the time of that key.

import type * as THREE from "three";
import { bindTimeline } from "../../anim/timeline";
import type { Actor } from "../../view/actor";
import type { Viewport } from "../../view/viewport";
import type { Changes, EditClip, EditCurve, Editor } from "../contract";
import { clipTime } from "../document";
import { refreshTangents } from "../keys";
import { keyAt, valueAtKey, withKey } from "../posing";
import { parentColumns, startOf } from "./manipulate";
import type { PathKey, PathKeys } from "./paths";
import { CameraSight } from "./sight";
import { add, dot, length, scaled, solve, subtract, type Vec } from "./spaces";

const curvesOf = new WeakMap<EditClip, Map<string, EditCurve[]>>();

/** Curves of joints by name. */
function byJoint(clip: EditClip): Map<string, EditCurve[]> {
  let found = curvesOf.get(clip);
  if (!found) {
    curvesOf.set(clip, (found = new Map()));
    for (const curve of clip.curves.values()) {
      const { target, property } = curve.channel;
      if (property === "weight" || property === "value") continue;
      const own = found.get(target);
      if (own) own.push(curve);
      else found.set(target, [curve]);
    }
  }
  return found;
}

/**
 * The keys that a joint's path shows: those of its place where it moves by itself, and these can be dragged; else those of
 * the nearest joint, itself or above it, that has several.
 */
export function pathKeys(editor: Editor, joint: number): PathKeys {
  const { actor, clip, layer } = editor;
  const none = { times: new Float64Array(0), draggable: false };
  const placement = layer?.placements.find((p) => p.animation === clip?.name);
  if (!actor || !clip || !placement) return none;
  const { rig } = actor;
  for (let j = joint; j >= 0; j = rig.parents[j]) {
    const own = byJoint(clip).get(rig.names[j]) ?? [];
    const moves = (c: EditCurve) => c.channel.property === "translation" && (c.times.length > 1 || rig.parents[j] < 0);
    const places = j === joint ? own.filter(moves) : [];
    // one key does not move anything
    if (places.length === 0 && !own.some((c) => c.times.length > 1) && rig.parents[j] >= 0) continue;
    const times = [...new Set((places.length > 0 ? places : own).flatMap((c) => [...c.times]))].sort((a, b) => a - b);
    return { times: Float64Array.from(times, (t) => timelineTime(editor, t)), draggable: places.length > 0 };
  }
  return none;
}

/** Seconds of the clip on the timeline, in its first cycle. */
function timelineTime({ clip, layer }: Editor, time: number): number {
  const placement = layer!.placements.find((p) => p.animation === clip!.name)!;
  const at = clipTime(placement, clip!, placement.start);
  return placement.start + (time - at) / placement.speed;
}

export class PathDrag {
  private readonly sight: CameraSight;
  private readonly first: Vec;
  private readonly from: Vec;
  private readonly toJoint: (delta: Vec) => Vec | null;
  private readonly before: { translation: number[]; rotation: number[]; scale: number[] };
  private changes: Changes | null = null;

  constructor(
    private readonly editor: Editor,
    view: Viewport,
    private readonly actor: Actor,
    private readonly key: PathKey,
    pointer: { x: number; y: number },
  ) {
    this.sight = new CameraSight(view, actor);
    this.from = vec(key.position);
    this.first = this.onPicture(pointer.x, pointer.y);
    const pose = actor.rig.newPose(), world = new Float64Array(12 * actor.rig.count);
    actor.evaluate(key.time, pose, world);
    const { joint } = key;
    this.before = {
      translation: [...pose.translations.subarray(3 * joint, 3 * joint + 3)],
      rotation: [...pose.rotations.subarray(4 * joint, 4 * joint + 4)],
      scale: [...pose.scales.subarray(3 * joint, 3 * joint + 3)],
    };
    const parent = parentColumns(startOf(actor.rig, pose, world), joint);
    this.toJoint = (delta) => solve(parent, delta);
  }

  /** The pointer on the plane of the picture through the key. */
  private onPicture(x: number, y: number): Vec {
    const { origin, direction } = this.sight.ray(x, y), normal = this.sight.picture[2];
    const t = dot(subtract(this.from, origin), normal) / dot(direction, normal);
    return add(origin, scaled(direction, t));
  }

  movePointer(x: number, y: number): string {
    const delta = subtract(this.onPicture(x, y), this.first);
    const local = this.toJoint(delta);
    const { editor, actor, key } = this;
    const { clip, layer, timeline } = editor;
    if (!local || !clip || !layer || !timeline) return "";
    const translation = this.before.translation.map((v, c) => v + local[c]);
    // what the layer must hold so that the whole timeline gives this place
    const bound = bindTimeline(editor.document, timeline.name, actor.rig, actor.morphNames);
    const value = bound ? bound.valueForResult(layer.name, key.time, key.joint, { ...this.before, translation }).translation : translation;
    this.changes = this.keyed(value);
    editor.preview(this.changes);
    return `Move the key at frame ${(key.time * timeline.rate).toFixed(1).replace(/\.0$/, "")}  ·  ${length(delta).toFixed(3)} m`;
  }

  private keyed(value: readonly number[]): Changes {
    const { editor, actor, key } = this;
    const clip = editor.document.clips.get(editor.clip!.name)!;
    const placement = editor.layer!.placements.find((p) => p.animation === clip.name)!;
    const time = clipTime(placement, clip, key.time);
    const curves = new Map<string, EditCurve | null>();
    for (const curve of clip.curves.values()) {
      const { target, property, component } = curve.channel;
      if (target !== actor.rig.names[key.joint] || property !== "translation") continue;
      const k = keyAt(curve, time);
      if (k < 0) continue;
      const next = component === null ? [...value] : [value[component]];
      if (next.every((v, c) => v === valueAtKey(curve, k)[c])) continue;
      curves.set(curve.channel.key, refreshTangents(withKey(curve, curve.channel, curve.times[k], next)));
    }
    return { curves: new Map([[clip.name, curves]]) };
  }

  finish(): void {
    if (this.changes) this.editor.commit(`Move ${this.actor.rig.names[this.key.joint]} on its path`, this.changes);
  }

  cancel(): void {
    this.editor.preview(null);
  }
}

const vec = (v: THREE.Vector3): Vec => [v.x, v.y, v.z];

/** Times of all keys of the active clip, on the timeline. */
export function allKeyTimes(editor: Editor): number[] {
  const { clip, layer } = editor;
  if (!clip || !layer?.placements.some((p) => p.animation === clip.name)) return [];
  const times = new Set<number>();
  for (const curve of clip.curves.values()) for (const t of curve.times) times.add(timelineTime(editor, t));
  return [...times].sort((a, b) => a - b);
}
