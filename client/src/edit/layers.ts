// What the layers panel and the clip tab do to the timeline; each call is one step of undo.

import type { Changes, EditClip, EditCurve, EditLayer, EditPlacement, EditTimeline } from "./contract";
import { channelOf } from "./contract";
import { basePlacement, freeName, newClip, newLayer, newPlacement, withLayer } from "./document";
import { editor } from "./editor.svelte";
import { evaluator } from "../anim/timeline";
import { refreshTangents } from "./keys";
import { withKey } from "./posing";

/** Replace the active timeline; with clips that it needs. */
export function changeTimeline(label: string, change: (timeline: EditTimeline) => EditTimeline, clips?: ReadonlyMap<string, EditClip | null>): void {
  const timeline = editor.document.timelines.get(editor.timeline?.name ?? "");
  if (!timeline) return;
  const changes: Changes = { timelines: new Map([[timeline.name, change(timeline)]]), ...(clips ? { clips } : {}) };
  editor.commit(label, changes);
}

/** Show a change of the active timeline without making it. */
export function previewTimeline(change: (timeline: EditTimeline) => EditTimeline): void {
  const timeline = editor.document.timelines.get(editor.timeline?.name ?? "");
  if (timeline) editor.preview({ timelines: new Map([[timeline.name, change(timeline)]]) });
}

const layerIn = (timeline: EditTimeline, name: string) => timeline.layers.find((l) => l.name === name)!;

export const layerChange = (name: string, change: Partial<EditLayer>) => (timeline: EditTimeline) =>
  withLayer(timeline, name, { ...layerIn(timeline, name), ...change });

export function changeLayer(label: string, name: string, change: Partial<EditLayer>): void {
  changeTimeline(label, layerChange(name, change));
}

/** A layer over the active one, with a clip of its own to set keys on. */
export function addLayer(mode: EditLayer["mode"]): void {
  const { timeline, layer, document } = editor;
  if (!timeline) return;
  const name = freeName(mode === "add" ? "Additive" : "Layer", timeline.layers.map((l) => l.name));
  const clip = freeName(`${timeline.name} ${name}`, document.clips.keys());
  const made = newLayer(name, [basePlacement(clip)], mode);
  changeTimeline(
    `Add layer ${name}`,
    (t) => {
      const at = layer ? t.layers.findIndex((l) => l.name === layer.name) + 1 : t.layers.length;
      return { ...t, layers: [...t.layers.slice(0, at), made, ...t.layers.slice(at)] };
    },
    new Map([[clip, newClip(clip, timeline.rate)]]),
  );
  editor.activateLayer(name);
}

/** The layer goes, and the clips that nothing else places. */
export function removeLayer(name: string): void {
  const { timeline, document } = editor;
  if (!timeline) return;
  const own = new Set(layerIn(timeline, name).placements.map((p) => p.animation));
  for (const other of document.timelines.values())
    for (const layer of other.layers)
      if (other.name !== timeline.name || layer.name !== name) for (const { animation } of layer.placements) own.delete(animation);
  changeTimeline(`Remove layer ${name}`, (t) => withLayer(t, name, null), new Map([...own].map((clip) => [clip, null])));
}

export function renameLayer(from: string, to: string): void {
  const { timeline } = editor;
  if (!timeline || !to || to === from) return;
  if (timeline.layers.some((l) => l.name === to)) {
    editor.toast("error", "This name is taken", `Another layer is called “${to}”.`);
    return;
  }
  const active = editor.layer?.name === from;
  changeLayer(`Rename layer to ${to}`, from, { name: to });
  if (active) editor.activateLayer(to);
}

/** Put a layer at a place, counted from below. */
export function moveLayer(name: string, to: number): void {
  const { timeline } = editor;
  if (!timeline || timeline.layers.findIndex((l) => l.name === name) === to) return;
  changeTimeline(`Move layer ${name}`, (t) => {
    const rest = t.layers.filter((l) => l.name !== name);
    return { ...t, layers: [...rest.slice(0, to), layerIn(t, name), ...rest.slice(to)] };
  });
}

/** Only the selected joints are moved by the layer; all of them where nothing is selected. */
export function maskFromSelection(): void {
  const { layer, actor, selectedJoints } = editor;
  if (!layer || !actor) return;
  const joints = Object.fromEntries(selectedJoints.map((j) => [actor.rig.names[j], 1]));
  changeLayer(selectedJoints.length > 0 ? "Mask layer" : "Unmask layer", layer.name, { joints });
}

// ---- influence -------------------------------------------------------------------------------------------------------

export function influenceAt(layer: EditLayer, time: number): number {
  if (typeof layer.influence === "number") return layer.influence;
  const out = new Float64Array(1);
  evaluator(layer.influence).sample(time, out, 0);
  return Math.max(0, Math.min(1, out[0]));
}

const influenceCurve = (known: EditCurve | undefined, time: number, value: number): EditCurve =>
  refreshTangents(withKey(known, channelOf("influence", "value"), time, [value]));

/** The influence as it would be with this value now: a key where it is keyed, else for all times. */
export function withInfluence(layer: EditLayer, time: number, value: number): number | EditCurve {
  return typeof layer.influence === "number" ? value : influenceCurve(layer.influence, time, value);
}

/** Key the influence at this time. */
export function keyInfluence(): void {
  const { layer, time } = editor;
  if (!layer) return;
  const known = typeof layer.influence === "number" ? undefined : layer.influence;
  changeLayer("Key influence", layer.name, { influence: influenceCurve(known, time, influenceAt(layer, time)) });
}

/** One influence for all times: what it is now. */
export function unkeyInfluence(): void {
  const { layer, time } = editor;
  if (layer) changeLayer("Influence without keys", layer.name, { influence: influenceAt(layer, time) });
}

// ---- placements ------------------------------------------------------------------------------------------------------

export const placementChange = (layer: string, index: number, change: Partial<EditPlacement>) => (timeline: EditTimeline) => {
  const { placements } = layerIn(timeline, layer);
  return withLayer(timeline, layer, {
    ...layerIn(timeline, layer),
    placements: placements.map((p, n) => (n === index ? { ...p, ...change } : p)),
  });
};

export function changePlacement(label: string, index: number, change: Partial<EditPlacement>): void {
  if (editor.layer) changeTimeline(label, placementChange(editor.layer.name, index, change));
}

/** Place a clip on the active layer, where the time is. */
export function addPlacement(clip: string): void {
  const { layer, time } = editor;
  if (!layer) return;
  const placement = { ...newPlacement(clip), start: time };
  changeLayer(`Place ${clip}`, layer.name, { placements: [...layer.placements, placement] });
  editor.activateLayer(layer.name, layer.placements.length);
}

export function removePlacement(index: number): void {
  const { layer } = editor;
  if (layer) changeLayer("Remove placement", layer.name, { placements: layer.placements.filter((_, n) => n !== index) });
}

// ---- the timeline itself ---------------------------------------------------------------------------------------------

export function setRange(start: number, end: number): void {
  if (end < start) return;
  changeTimeline("Range", (t) => ({ ...t, start, end }));
}

export function addMarker(name: string, time: number): void {
  changeTimeline(`Add marker ${name}`, (t) => ({
    ...t,
    markers: [...t.markers.filter((m) => Math.abs(m.time - time) > 1e-6), { time, name }].sort((a, b) => a.time - b.time),
  }));
}

export function removeMarker(time: number): void {
  changeTimeline("Remove marker", (t) => ({ ...t, markers: t.markers.filter((m) => m.time !== time) }));
}
