// Documents and changes as they travel: see src/keypose/studio/edit_messages.py.

import type {
  ArrayRef,
  ChannelData,
  ClipChange,
  CurveData,
  EditCommand,
  Envelope,
  LayerData,
  PlacementData,
  PoseData,
  ProjectChanged,
  ProjectCharacter,
  ProjectClip,
  ProjectState,
  TimelineData,
} from "../generated/messages";
import { Arrays, type Container, type Packer } from "../net/container";
import {
  channelOf,
  type Changes,
  type ChannelId,
  type EditClip,
  type EditCurve,
  type EditDocument,
  type EditLayer,
  type EditPlacement,
  type EditTimeline,
  type StoredPose,
} from "./contract";
import { newClip } from "./document";

// ---- from the server -------------------------------------------------------------------------------------------------

class Reader {
  private readonly arrays: Arrays;

  constructor(container: Container<Envelope>) {
    this.arrays = new Arrays(container);
  }

  private doubles(ref: ArrayRef): Float64Array {
    const found = this.arrays.floats(ref);
    // copied out of the message, whose buffer would otherwise live as long as one small curve
    return Float64Array.from(found);
  }

  private optional(ref: ArrayRef | null): Float64Array | null {
    return ref ? this.doubles(ref) : null;
  }

  curve(data: CurveData): EditCurve {
    const times = this.doubles(data.times), values = this.doubles(data.values);
    return {
      channel: channelOf(data.target, data.property, data.component),
      kind: data.kind,
      components: times.length > 0 ? values.length / times.length : 1,
      times,
      values,
      modes: this.arrays.uint8(data.modes).slice(),
      inTangents: this.optional(data.in_tangents),
      outTangents: this.optional(data.out_tangents),
      inHandles: this.optional(data.in_handles),
      outHandles: this.optional(data.out_handles),
      types: data.types ? this.arrays.uint8(data.types).slice() : null,
      before: data.before,
      after: data.after,
    };
  }

  clip(data: ProjectClip): EditClip {
    const curves = data.curves.map((c) => this.curve(c));
    return { name: data.name, rate: data.rate_hz, curves: new Map(curves.map((c) => [c.channel.key, c])), eulerOrders: data.euler_orders };
  }

  changed(before: EditClip | undefined, data: ClipChange): EditClip {
    const curves = new Map((before ?? newClip(data.name)).curves);
    for (const { target, property, component } of data.removed) curves.delete(channelOf(target, property, component).key);
    for (const curve of data.curves.map((c) => this.curve(c))) curves.set(curve.channel.key, curve);
    return { name: data.name, rate: data.rate_hz, curves, eulerOrders: data.euler_orders };
  }

  private placement(data: PlacementData): EditPlacement {
    return {
      animation: data.animation,
      start: data.start_s,
      inTime: data.in_s,
      outTime: data.out_s,
      speed: data.speed,
      cycles: data.cycles,
      fadeIn: data.fade_in_s,
      fadeOut: data.fade_out_s,
      timeWarp: data.time_warp && this.curve(data.time_warp),
      weight: data.weight && this.curve(data.weight),
      hold: data.hold,
      muted: data.muted,
    };
  }

  timeline(data: TimelineData): EditTimeline {
    return {
      name: data.name,
      layers: data.layers.map(
        (layer): EditLayer => ({
          ...layer,
          placements: layer.placements.map((p) => this.placement(p)),
          influence: typeof layer.influence === "number" ? layer.influence : this.curve(layer.influence),
        }),
      ),
      rate: data.rate_hz,
      start: data.start_s,
      end: data.end_s,
      holdFrames: data.hold_frames,
      markers: data.markers.map((m) => ({ time: m.time_s, name: m.name })),
    };
  }
}

const named = <V extends { readonly name: string }>(values: readonly V[]) => new Map(values.map((v) => [v.name, v]));
const characters = (data: ProjectCharacter[]) => data.map(({ name, scene, timeline }) => ({ name, scene: scene.id, timeline }));

export function readState(state: ProjectState, container: Container<Envelope>): EditDocument {
  const reader = new Reader(container);
  return {
    name: state.status.name,
    clips: named(state.clips.map((c) => reader.clip(c))),
    timelines: named(state.timelines.map((t) => reader.timeline(t))),
    poses: named(state.poses as StoredPose[]),
    rigs: state.rigs,
    characters: characters(state.characters),
  };
}

/** The document after a step; everything that the step left alone is shared. */
export function readChanged(before: EditDocument, change: ProjectChanged, container: Container<Envelope>): EditDocument {
  const reader = new Reader(container);
  const next = <V extends { readonly name: string }>(old: ReadonlyMap<string, V>, removed: string[], put: V[]) => {
    if (removed.length === 0 && put.length === 0) return old;
    const out = new Map(old);
    for (const name of removed) out.delete(name);
    for (const value of put) out.set(value.name, value);
    return out;
  };
  return {
    name: change.status.name,
    clips: next(before.clips, change.removed_clips, change.clips.map((c) => reader.changed(before.clips.get(c.name), c))),
    timelines: next(before.timelines, change.removed_timelines, change.timelines.map((t) => reader.timeline(t))),
    poses: next(before.poses, change.removed_poses, change.poses as StoredPose[]),
    rigs: change.rigs ?? before.rigs,
    characters: change.characters ? characters(change.characters) : before.characters,
  };
}

// ---- to the server ---------------------------------------------------------------------------------------------------

const channelData = ({ target, property, component }: ChannelId): ChannelData => ({ target, property, component });

function curveData(packer: Packer, curve: EditCurve): CurveData {
  const K = curve.times.length, C = curve.components;
  const optional = (array: Float64Array | null, ...shape: number[]) => array && packer.add(array, shape);
  return {
    ...channelData(curve.channel),
    kind: curve.kind,
    times: packer.add(curve.times, [K]),
    values: packer.add(curve.values, [K, C]),
    modes: packer.add(curve.modes, [K]),
    in_tangents: optional(curve.inTangents, K, C),
    out_tangents: optional(curve.outTangents, K, C),
    in_handles: optional(curve.inHandles, K, C, 2),
    out_handles: optional(curve.outHandles, K, C, 2),
    types: curve.types && packer.add(curve.types, [K, 2]),
    before: curve.before,
    after: curve.after,
  };
}

function placementData(packer: Packer, p: EditPlacement): PlacementData {
  return {
    animation: p.animation,
    start_s: p.start,
    in_s: p.inTime,
    out_s: p.outTime,
    speed: p.speed,
    cycles: p.cycles,
    fade_in_s: p.fadeIn,
    fade_out_s: p.fadeOut,
    time_warp: p.timeWarp && curveData(packer, p.timeWarp),
    weight: p.weight && curveData(packer, p.weight),
    hold: p.hold,
    muted: p.muted,
  };
}

function timelineData(packer: Packer, timeline: EditTimeline): TimelineData {
  return {
    name: timeline.name,
    layers: timeline.layers.map(
      (layer): LayerData => ({
        ...layer,
        placements: layer.placements.map((p) => placementData(packer, p)),
        influence: typeof layer.influence === "number" ? layer.influence : curveData(packer, layer.influence),
        joints: { ...layer.joints },
        properties: layer.properties && [...layer.properties],
      }),
    ),
    rate_hz: timeline.rate,
    start_s: timeline.start,
    end_s: timeline.end,
    hold_frames: timeline.holdFrames,
    markers: timeline.markers.map((m) => ({ time_s: m.time, name: m.name })),
  };
}

/** Changes as commands; clips come before the timelines that place them. */
export function commandsOf(packer: Packer, changes: Changes): EditCommand[] {
  const commands: EditCommand[] = [];
  for (const [name, clip] of changes.clips ?? []) {
    if (!clip) continue;
    const curves = [...clip.curves.values()].map((c) => curveData(packer, c));
    commands.push({ kind: "set_clip", clip: { name, rate_hz: clip.rate, curves, euler_orders: { ...clip.eulerOrders } } });
  }
  for (const [clip, own] of changes.curves ?? []) {
    const curves = [...own.values()].flatMap((c) => (c ? [curveData(packer, c)] : []));
    const removed = [...own].flatMap(([key, c]) => {
      if (c) return [];
      const [target, property, component] = key.split("\u0000");
      return [{ target, property: property as ChannelId["property"], component: component === "" ? null : Number(component) }];
    });
    commands.push({ kind: "set_curves", clip, curves, removed, euler_orders: {} });
  }
  for (const [name, timeline] of changes.timelines ?? [])
    commands.push(timeline ? { kind: "set_timeline", timeline: timelineData(packer, timeline) } : { kind: "remove_timeline", name });
  for (const [name, pose] of changes.poses ?? [])
    commands.push(pose ? { kind: "set_pose", pose: structuredClone(pose) as PoseData } : { kind: "remove_pose", name });
  for (const [name, clip] of changes.clips ?? []) if (!clip) commands.push({ kind: "remove_clip", name });
  return commands;
}
