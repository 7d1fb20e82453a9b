// The editor: the document as the server has it, what was done since and is on its way there, and what is shown now.

import { LOOP_MODES } from "../anim/clock";
import type { Pose } from "../anim/rig";
import { studio } from "../studio.svelte";
import type { Actor } from "../view/actor";
import {
  channelOf,
  type ChannelId,
  type Changes,
  type EditClip,
  type EditCurve,
  type EditDocument,
  type EditLayer,
  type Editor as EditorContract,
  type EditPlacement,
  type EditTimeline,
  type KeySelection,
  type Property,
} from "./contract";
import { apply, clipTime, EMPTY, keyTimes, reuse } from "./document";
import { layerValues, TimelineAnimation, without } from "./evaluate";
import { HeldPose, type HeldValues } from "./held.svelte";
import { deleteKeys, refreshTangents, valueAt } from "./keys";
import { layout } from "./layout.svelte";
import type { Link, Values } from "./link";
import { channelsFor, keyAt, keyBefore, orderOf, rotationOf, setLocal, valueAtKey, valueOf, withKey } from "./posing";

/** Lets the controls of rigs move joints; `edit/rig/rigging.svelte.ts`. */
interface Rigging {
  apply(document: EditDocument, character: string, timeline: string, actor: Actor, time: number, pose: Pose): void;
  refresh(): void;
}

interface Pending {
  readonly id: string;
  /** The revision that holds it, once the server has answered. */
  readonly revision: number;
  readonly changes: Changes;
}

const NOTHING: KeySelection = new Map();
const PROPERTY_ORDER: readonly Property[] = ["translation", "rotation", "euler", "scale", "weight", "value"];

export class Editor implements EditorContract {
  document = $state.raw<EditDocument>(EMPTY);
  shown = $state.raw<EditDocument>(EMPTY);
  /** Whether a project is open. */
  open = $state(false);

  private characterName = $state("");
  private layerName = $state("");
  private placementIndex = $state(0);
  private joints = $state.raw<readonly number[]>([]);
  selection = $state.raw<KeySelection>(NOTHING);
  hidden = $state.raw<ReadonlySet<string>>(new Set());
  private mutedKeys = $state.raw<ReadonlySet<string>>(new Set());
  locked = $state.raw<ReadonlySet<string>>(new Set());
  autoKey = $state(false);
  snap = $state(true);
  /** Only channels whose name holds this are listed. */
  query = $state("");
  readonly held = new HeldPose();
  span = $state.raw<readonly [number, number] | null>(null);
  /** Steps on their way to the server. */
  waiting = $state(0);

  link: Link | null = null;
  rigging: Rigging | null = null;
  private confirmed: EditDocument = EMPTY;
  private pending: Pending[] = [];
  private previewed: Changes | null = null;
  private queue: Promise<void> = Promise.resolve();

  character = $derived.by(() => {
    const { characters } = this.document;
    return characters.find((c) => c.name === this.characterName) ?? characters[0] ?? null;
  });
  actor = $derived.by((): Actor | null => this.actorOf(this.character?.name ?? ""));
  timeline = $derived.by((): EditTimeline | null => this.shown.timelines.get(this.character?.timeline ?? "") ?? null);
  layer = $derived.by((): EditLayer | null => {
    const layers = this.timeline?.layers ?? [];
    return layers.find((l) => l.name === this.layerName) ?? layers.at(-1) ?? null;
  });
  placement = $derived.by((): EditPlacement | null => this.layer?.placements[this.placementIndex] ?? this.layer?.placements[0] ?? null);
  clip = $derived.by((): EditClip | null => this.shown.clips.get(this.placement?.animation ?? "") ?? null);

  channels = $derived.by((): readonly EditCurve[] => {
    const { clip, actor } = this;
    if (!clip) return [];
    const rig = actor?.rig ?? null;
    const chosen = layout.onlySelected && rig && this.joints.length > 0 ? new Set(this.joints.map((j) => rig.names[j])) : null;
    // the numbers of a control are listed with it
    const data = chosen && this.shown.rigs.find((r) => r.character === this.character?.name);
    for (const a of data?.attributes ?? []) if (chosen!.has(a.control)) chosen!.add(a.name);
    const text = this.query.trim().toLowerCase();
    const row = (c: ChannelId) => {
      const joint = rig ? rig.index(c.target) : -1;
      return joint < 0 ? 1e6 : joint;
    };
    return [...clip.curves.values()]
      .filter(({ channel: c }) => (!chosen || chosen.has(c.target)) && (!text || `${c.target} ${c.property}`.toLowerCase().includes(text)))
      .sort(({ channel: a }, { channel: b }) =>
        row(a) - row(b) || (a.target < b.target ? -1 : a.target > b.target ? 1 : 0) ||
        PROPERTY_ORDER.indexOf(a.property) - PROPERTY_ORDER.indexOf(b.property) || (a.component ?? -1) - (b.component ?? -1));
  });

  // ---- the document ------------------------------------------------------------------------------------------------

  /** The whole document, or another one: then nothing of the old one is chosen any more. */
  take(document: EditDocument, same: boolean, revision: number): void {
    this.confirmed = document;
    this.revision = revision;
    this.pending = this.pending.filter((p) => p.revision > revision);
    this.open = true;
    if (!same) {
      this.pending = [];
      this.previewed = null;
      this.selection = NOTHING;
      this.selectedJoints = [];
      this.hidden = this.locked = this.mutedKeys = new Set();
      this.held.forget();
      this.span = null;
      studio.framed.clear();
      this.characterName = this.layerName = "";
    }
    this.show();
    this.setPace();
  }

  /** The document after a step of the server; `id` is that of our commit which it holds. */
  confirm(document: EditDocument, id: string, revision: number): void {
    this.confirmed = document;
    this.revision = revision;
    this.pending = this.pending.filter((p) => p.id !== id);
    this.show();
  }

  private show(): void {
    const before = this.document, scene = this.character?.scene;
    let document = this.confirmed;
    for (const { changes } of this.pending) document = apply(document, changes);
    document = reuse(before, document);
    this.document = document;
    this.shown = this.previewed ? apply(document, this.previewed) : document;
    if (this.character?.scene !== scene) this.selectedJoints = [];
    if (document !== before) this.prune();
    this.perform();
    const [old, now] = [before.timelines.get(this.character?.timeline ?? ""), this.timeline];
    if (now && (now.start !== old?.start || now.end !== old.end || now.rate !== old.rate)) this.setPace();
  }

  /** Keys that are gone are not selected any more. */
  private prune(): void {
    const { clip } = this;
    let changed = false;
    const kept = new Map<string, Uint32Array>();
    for (const [key, indices] of this.selection) {
      const count = clip?.curves.get(key)?.times.length ?? 0;
      const left = indices.length > 0 && indices[indices.length - 1] < count ? indices : indices.filter((k) => k < count);
      if (left.length > 0) kept.set(key, left);
      changed ||= left !== indices;
    }
    if (changed) this.selection = kept;
  }

  preview(changes: Changes | null): void {
    this.previewed = changes && this.allowed(changes);
    this.shown = this.previewed ? apply(this.document, this.previewed) : this.document;
    this.perform();
  }

  commit(label: string, changes: Changes): void {
    this.previewed = null;
    const { link } = this;
    const own = this.allowed(changes);
    if (!link || !own || apply(this.document, own) === this.document) {
      this.shown = this.document;
      this.perform();
      return;
    }
    this.held.settle();
    const id = `${this.session}-${++this.count}`;
    this.pending = [...this.pending, { id, changes: own, revision: Infinity }];
    this.show();
    const drop = (error: unknown) => {
      this.pending = this.pending.filter((p) => p.id !== id);
      this.show();
      throw error;
    };
    // it stays shown until the document that holds it has come: by `confirm`, or by `take` where that was missed
    const answered = (revision: number) => {
      this.pending = this.pending.flatMap((p) => (p.id !== id ? [p] : revision > this.revision ? [{ ...p, revision }] : []));
    };
    void this.enqueue(() => link.commit(id, label, own).then(answered, drop), `“${label}” was not accepted`);
  }
  private revision = -1;
  private readonly session = Math.random().toString(36).slice(2, 10);
  private count = 0;

  /** Requests go one after the other, so that the server sees them in the order in which they were made. */
  enqueue(request: () => Promise<void>, failure: string): Promise<void> {
    this.waiting++;
    this.queue = this.queue.then(request).catch((error: unknown) => {
      this.toast("error", failure, error instanceof Error ? error.message : String(error));
    });
    return this.queue.finally(() => this.waiting--);
  }

  /** Changes without those of locked channels and layers; null where nothing is left. */
  private allowed(changes: Changes): Changes | null {
    const { clip, layer, locked } = this;
    const own = clip && changes.curves?.get(clip.name);
    if (!own) return changes;
    if (layer?.locked) {
      this.toast("info", "This layer is locked", `Unlock “${layer.name}” in the layers panel to change its keys.`);
      return null;
    }
    if (locked.size === 0) return changes;
    const left = new Map([...own].filter(([key]) => !locked.has(key)));
    return { ...changes, curves: new Map(changes.curves).set(clip.name, left) };
  }

  operate(name: string, parameters: Record<string, unknown>): Promise<void> {
    const { link, clip } = this;
    if (!link || !clip) return Promise.resolve();
    const listed = this.channels.map((c): [string, null] => [c.channel.key, null]);
    const channels: ReadonlyMap<string, Uint32Array | null> = this.selection.size > 0 ? this.selection : new Map(listed);
    const ends = this.span?.map((time) => this.clipTime(time)).sort((a, b) => a - b);
    const scope = { clip: clip.name, character: this.character?.name ?? "", channels, span: ends ? ([ends[0], ends[1]] as const) : null };
    return this.enqueue(() => link.operate(name, scope, parameters as Values), "This could not be done");
  }

  /** Take back what was posed last and is held, else the last step of the document. */
  undo(): void {
    if (this.held.undo()) studio.view.invalidatePose();
    else this.step(1);
  }

  redo(): void {
    if (this.held.redo()) studio.view.invalidatePose();
    else this.step(-1);
  }

  /** Undo (or, negative, redo) so many steps. */
  step(steps: number): void {
    const { link } = this;
    if (!link) return;
    for (let n = 0; n < Math.abs(steps); n++)
      void this.enqueue(() => (steps > 0 ? link.undo() : link.redo()), steps > 0 ? "Nothing was undone" : "Nothing was redone");
  }

  // ---- who is edited -----------------------------------------------------------------------------------------------

  actorOf(character: string): Actor | null {
    const found = this.document.characters.find((c) => c.name === character);
    return studio.actors.find((a) => a.sceneId === found?.scene) ?? null;
  }

  activate(character: string): void {
    this.characterName = character;
    this.selectedJoints = [];
    this.selection = NOTHING;
    if (this.actor) studio.activate(this.actor);
    this.setPace();
  }

  activateLayer(name: string, placement = 0): void {
    if (name === this.layer?.name && this.placement === this.layer.placements[placement]) return;
    this.layerName = name;
    this.placementIndex = placement;
    this.selection = NOTHING;
    this.perform();
  }

  get selectedJoints(): readonly number[] {
    return this.joints;
  }

  set selectedJoints(joints: readonly number[]) {
    this.joints = joints;
    const active = joints.at(-1) ?? -1;
    if (studio.selected !== active && studio.view) studio.select(active);
  }

  /** A click on a joint: alone, or with Shift in addition. */
  pick(joint: number, more: boolean): void {
    if (joint < 0) this.selectedJoints = more ? this.joints : [];
    else if (!more) this.selectedJoints = [joint];
    else if (this.joints.at(-1) === joint) this.selectedJoints = this.joints.filter((j) => j !== joint);
    else this.selectedJoints = [...this.joints.filter((j) => j !== joint), joint];
  }

  get muted(): ReadonlySet<string> {
    return this.mutedKeys;
  }

  set muted(keys: ReadonlySet<string>) {
    this.mutedKeys = keys;
    this.perform();
  }

  /** The page is turned to: its actors have just come onto the stage. */
  enter(): void {
    this.perform();
    this.setPace();
    if (this.actor) studio.activate(this.actor);
    studio.select(this.joints.at(-1) ?? -1);
  }

  // ---- what is shown -----------------------------------------------------------------------------------------------

  /** Bind what is shown to the actors. */
  perform(): void {
    if (!this.open || !studio.view) return;
    const document = without(this.shown, this.clip, this.mutedKeys);
    for (const { name, timeline } of document.characters) {
      const actor = this.actorOf(name), own = document.timelines.get(timeline);
      if (!actor) continue;
      const over = (time: number, pose: Pose) => {
        if (actor === this.actor) this.applyPosed(time, pose);
        this.rigging?.apply(document, name, timeline, actor, time, pose);
      };
      actor.setAnimation(own ? new TimelineAnimation(document, own, actor.sceneId, over) : null);
    }
    this.rigging?.refresh();
    studio.view.invalidatePose();
  }

  private applyPosed(time: number, pose: Pose): void {
    if (this.posed.size > 0 && Math.abs(time - this.held.time) < 1e-9) this.writePose(this.actor!, pose, this.posed);
  }

  private writePose({ rig, morphNames }: Actor, pose: Pose, values: ReadonlyMap<string, readonly number[]>): void {
    for (const [key, value] of values) {
      const [target, property] = key.split("\u0000") as [string, Property];
      if (property === "weight" || property === "value") {
        const m = property === "weight" ? morphNames.indexOf(target) : rig.attributeIndex(target);
        if (m >= 0) pose.morphs[m] = value[0];
        continue;
      }
      const joint = rig.index(target);
      if (joint < 0) continue;
      if (property === "euler") setLocal(pose, joint, "rotation", rotationOf(value, orderOf(this.clip, target)));
      else setLocal(pose, joint, property, value);
    }
  }

  // ---- time --------------------------------------------------------------------------------------------------------

  get rate(): number {
    return this.timeline?.rate ?? 25;
  }

  get time(): number {
    return studio.time;
  }

  set time(time: number) {
    this.seek(time);
  }

  /** Where the active clip is at the current time of the timeline. */
  clipTime(time = this.time): number {
    return this.placement ? clipTime(this.placement, this.clip ?? undefined, time) : time;
  }

  seek(time: number): void {
    if (!studio.view) return;
    studio.view.clock.time = studio.time = time;
    studio.view.invalidatePose();
    this.timeMoved();
  }

  /** Poses that were set by hand and not keyed do not outlast their moment. */
  timeMoved(): void {
    if (this.posed.size > 0 && Math.abs(studio.time - this.held.time) > 1e-9) this.held.forget();
  }

  seekFrame(frame: number): void {
    this.seek(frame / this.rate);
  }

  /** On by whole frames. */
  stepFrames(frames: number): void {
    studio.pause();
    const frame = this.time * this.rate;
    this.seekFrame(frames > 0 ? Math.floor(frame + 1e-6) + frames : Math.ceil(frame - 1e-6) + frames);
  }

  seekKey(direction: number): void {
    studio.pause();
    const now = this.clipTime(), times = keyTimes(this.channels);
    const next = direction > 0 ? times.find((t) => t > now + 1e-6) : times.findLast((t) => t < now - 1e-6);
    if (next !== undefined) this.seek(this.time + (next - now) / (this.placement?.speed ?? 1));
  }

  toggle(): void {
    if (studio.playing) return studio.pause();
    if (!this.timeline) return;
    this.setPace();
    const { clock } = studio.view;
    if (clock.time < clock.start || clock.time > clock.end) clock.time = clock.start;
    clock.play();
    studio.playing = true;
  }

  cycleMode(): void {
    studio.setMode(LOOP_MODES[(LOOP_MODES.indexOf(studio.mode) + 1) % LOOP_MODES.length]);
  }

  /** Range and rate of the timeline are those of the clock; the time stays, even outside. */
  setPace(): void {
    const { timeline } = this;
    if (!timeline || !studio.view || studio.page !== "edit") return;
    const { clock } = studio.view, { time } = clock;
    clock.rate = timeline.rate;
    clock.setRange(timeline.start, timeline.end);
    clock.time = time;
    studio.start = timeline.start;
    studio.end = timeline.end;
  }

  // ---- posing and keying -------------------------------------------------------------------------------------------

  get posed(): HeldValues {
    return this.held.values;
  }

  set posed(values: HeldValues) {
    this.held.restore(values);
  }

  dropPosed(): void {
    this.held.drop();
    studio.view.invalidatePose();
  }

  pose(values: ReadonlyMap<string, readonly number[]>, label: string, done: boolean): void {
    if (this.autoKey) {
      const changes = this.keysFor(values);
      if (done) this.commit(label, changes);
      else this.preview(changes);
      return;
    }
    this.held.hold(values, studio.time, label, done);
    studio.view.invalidatePose();
  }

  /** Curves of the active clip with keys of these values at the current time. */
  private keysFor(values: ReadonlyMap<string, readonly number[]>): Changes {
    const { actor } = this;
    const clip = this.document.clips.get(this.clip?.name ?? "") ?? null;
    if (!actor || !clip) return {};
    // the values go into the pose, from which everything that is keyed is read
    this.writePose(actor, actor.rig.pose, values);
    const channels = [...values.keys()].flatMap((key) => {
      const [target, property] = key.split("\u0000") as [string, Property];
      return channelsFor(clip, target, property, layout.rotations);
    });
    return this.keyed(actor, clip, channels, values);
  }

  /** Keys of channels as the actor's pose is now; `exact` are values that are not to be read from the pose. */
  private keyed(actor: Actor, clip: EditClip, channels: readonly ChannelId[], exact: ReadonlyMap<string, readonly number[]>): Changes {
    const { rig, morphNames } = actor;
    const curves = new Map<string, EditCurve | null>();
    const time = this.clipTime();
    const values = layerValues(this.document, this.timeline!, this.layer!.name, actor, this.time);
    const cache = new Map<number, ReturnType<typeof values>>();
    for (const channel of channels) {
      const known = clip.curves.get(channel.key);
      let value: number[] | null = null;
      if (channel.property === "weight" || channel.property === "value") {
        const m = channel.property === "weight" ? morphNames.indexOf(channel.target) : rig.attributeIndex(channel.target);
        if (m >= 0) value = [rig.pose.morphs[m]];
      } else {
        const joint = rig.index(channel.target);
        if (joint < 0) continue;
        if (!cache.has(joint)) cache.set(joint, values(joint));
        const local = cache.get(joint)!;
        const near = known && channel.component === null ? valueAtKey(known, keyBefore(known, time)) : null;
        const given = channel.property === "euler" ? exact.get(channelOf(channel.target, "euler").key) : undefined;
        if (given) value = channel.component === null ? [...given] : [given[channel.component]];
        else value = valueOf(local, orderOf(clip, channel.target), channel, near);
      }
      if (value) curves.set(channel.key, refreshTangents(withKey(known, channel, time, value)));
    }
    if ([...cache.values()].some((v) => !v.possible))
      this.toast("info", "Another layer has the last word", `What lies over “${this.layer!.name}”, or its influence, keeps it from showing this pose.`);
    return { curves: new Map([[clip.name, curves]]) };
  }

  insertKeys(joints: readonly number[], properties: readonly Property[], more: readonly ChannelId[] = []): void {
    const { actor, clip } = this;
    if (!actor || !clip || joints.length + more.length === 0) {
      this.toast("info", "Nothing to key", !clip ? "The active layer has no clip." : "Select a joint first.");
      return;
    }
    const channels = [...joints.flatMap((joint) => properties.flatMap((p) => channelsFor(clip, actor.rig.names[joint], p, layout.rotations))), ...more];
    const changes = this.keyed(actor, clip, channels, this.posed);
    this.held.forget();
    const what = joints.length === 1 ? actor.rig.names[joints[0]] : joints.length > 0 ? `${joints.length} joints` : more.map((c) => c.target).join(", ");
    this.commit(`Key ${what}`, changes);
  }

  /** Key morph weights as they are now. */
  insertMorphKeys(names: readonly string[]): void {
    const { actor, clip } = this;
    if (!actor || !clip || names.length === 0) return;
    const changes = this.keyed(actor, clip, names.map((name) => channelOf(name, "weight")), this.posed);
    this.held.forget();
    this.commit(`Key ${names.length === 1 ? names[0] : `${names.length} shapes`}`, changes);
  }

  /** Key numbers of a rig as they are now. */
  insertValueKeys(names: readonly string[]): void {
    const { actor, clip } = this;
    if (!actor || !clip || names.length === 0) return;
    const changes = this.keyed(actor, clip, names.map((name) => channelOf(name, "value")), this.posed);
    this.held.forget();
    this.commit(`Key ${names.length === 1 ? names[0] : `${names.length} numbers`}`, changes);
  }

  /** Remove the keys of channels at the current time. */
  removeKeys(channels: readonly string[]): void {
    const { clip } = this;
    if (!clip) return;
    const time = this.clipTime();
    const curves = new Map<string, EditCurve | null>();
    for (const key of channels) {
      const curve = clip.curves.get(key), k = curve ? keyAt(curve, time) : -1;
      if (curve && k >= 0) curves.set(key, deleteKeys(curve, Uint32Array.of(k)));
    }
    if (curves.size > 0) this.commit("Remove keys", { curves: new Map([[clip.name, curves]]) });
  }

  /** The angles (radians) that a joint's Euler curve gives now, or null where it has none. */
  anglesNow(joint: string): Float64Array | null {
    const curve = this.clip?.curves.get(channelOf(joint, "euler").key);
    return curve ? valueAt(curve, this.clipTime()) : null;
  }

  channelState(key: string): "none" | "curve" | "key" {
    const curve = this.clip?.curves.get(key);
    return !curve ? "none" : keyAt(curve, this.clipTime()) >= 0 ? "key" : "curve";
  }

  /** Whether a property of a joint has a channel, and a key at the current time. */
  keyState(joint: number, property: Property): "none" | "curve" | "key" {
    const { actor, clip } = this;
    if (!actor || !clip) return "none";
    const states = channelsFor(clip, actor.rig.names[joint], property, layout.rotations).map((c) => this.channelState(c.key));
    return states.includes("key") ? "key" : states.includes("curve") ? "curve" : "none";
  }

  toast(kind: "error" | "info", title: string, message: string): void {
    studio.toast(kind, title, message);
  }
}

export const editor = new Editor();
