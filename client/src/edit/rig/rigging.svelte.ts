// Rigs on the edit page: what their controls make of the joints, asked of the server pose by pose while something is moved,
// and as a track of the whole timeline when it has come to rest.

import type { Pose } from "../../anim/rig";
import type { EditResult, RigAsked, RigData, RigPosed } from "../../generated/messages";
import { unpack } from "../../net/container";
import { studio } from "../../studio.svelte";
import type { Actor } from "../../view/actor";
import { channelOf, type EditDocument } from "../contract";
import { editor } from "../editor.svelte";
import { tools } from "../viewport/tools.svelte";
import { NO_WISH, Question, readSolved, transforms, writeSolved, type Solved, type Wish } from "./solver";

const TRACK_DELAY_MS = 120;

/** What a track or answer was made of. */
interface Basis {
  readonly clips: EditDocument["clips"];
  readonly timeline: unknown;
  readonly data: RigData;
}

class State {
  answer: { question: Question; solved: Solved } | null = null;
  track: { basis: Basis; solved: Solved } | null = null;
  asking: Question | null = null;
  wanted: Question | null = null;
  timer: ReturnType<typeof setTimeout> | null = null;
  fetching = false;
}

class Rigging {
  /** Bumped with every answer, for what shows numbers of it. */
  revision = $state(0);
  /** How long the last answers took, in milliseconds, newest last. */
  readonly latencies: number[] = [];
  private readonly states = new Map<string, State>();

  constructor() {
    editor.rigging = this;
  }

  dataOf(character: string | undefined, document: EditDocument = editor.shown): RigData | null {
    return document.rigs.find((r) => r.character === character) ?? null;
  }

  /** The rig of the character that is edited, where its controls are on the stage. */
  get active(): RigData | null {
    const data = this.dataOf(editor.character?.name), rig = editor.actor?.rig;
    return data && rig && rig.count - rig.jointCount === data.controls.length ? data : null;
  }

  private state(data: RigData): State {
    const kept = this.states.get(data.name);
    if (kept) return kept;
    const made = new State();
    this.states.set(data.name, made);
    return made;
  }

  /** Whether a timeline has keys on the rig: until then its joints are moved by channels of their own. */
  private keyed(document: EditDocument, timeline: string, data: RigData): boolean {
    const clips = new Set(document.timelines.get(timeline)?.layers.flatMap((l) => l.placements.map((p) => document.clips.get(p.animation))));
    const controls = new Set(data.controls.map((c) => c.name)), values = new Set(data.attributes.map((a) => a.name));
    for (const clip of clips)
      for (const { channel } of clip?.curves.values() ?? [])
        if (channel.property === "value" ? values.has(channel.target) : controls.has(channel.target)) return true;
    return false;
  }
  private readonly known = new WeakMap<EditDocument["clips"], Map<string, boolean>>();

  private isKeyed(document: EditDocument, timeline: string, data: RigData): boolean {
    let found = this.known.get(document.clips);
    if (!found) this.known.set(document.clips, (found = new Map()));
    const line = document.timelines.get(timeline);
    const key = `${data.revision} ${timeline} ${line?.layers.flatMap((l) => l.placements.map((p) => p.animation)).join("\u0000")}`;
    if (!found.has(key)) found.set(key, this.keyed(document, timeline, data));
    return found.get(key)!;
  }

  /** Let the controls in a pose of an actor move its joints. */
  apply(document: EditDocument, character: string, timeline: string, actor: Actor, time: number, pose: Pose): void {
    const data = this.dataOf(character, document), { rig } = actor;
    if (!data || rig.count - rig.jointCount !== data.controls.length) return;
    const state = this.state(data);
    const byHand = actor === editor.actor && this.posedByHand(data);
    if (!byHand && !this.isKeyed(document, timeline, data)) return;
    const { track } = state;
    const fresh = track !== null && track.basis.clips === document.clips && track.basis.timeline === document.timelines.get(timeline) && track.basis.data === data;
    if (pose !== rig.pose || (fresh && !byHand) || (studio.playing && track)) {
      if (track) writeSolved(track.solved, time, rig, pose);
      return;
    }
    const question = new Question(data, rig, pose);
    if (state.answer?.question.equals(question)) return writeSolved(state.answer.solved, 0, rig, pose);
    state.wanted = question;
    void this.ask(state);
    // the last answer is nearer to what is wanted than a track of before
    if (state.answer && (byHand || !track)) writeSolved(state.answer.solved, 0, rig, pose);
    else if (track) writeSolved(track.solved, time, rig, pose);
  }

  private posedByHand(data: RigData): boolean {
    if (editor.posed.size === 0) return false;
    const names = new Set([...data.controls.map((c) => c.name), ...data.attributes.map((a) => a.name)]);
    for (const key of editor.posed.keys()) if (names.has(key.split("\u0000")[0])) return true;
    return false;
  }

  private async ask(state: State): Promise<void> {
    if (state.asking) return;
    while (state.wanted) {
      const question = state.wanted;
      state.wanted = null;
      state.asking = question;
      try {
        const began = performance.now();
        const solved = await this.pose(question, NO_WISH);
        this.latencies.push(performance.now() - began);
        if (this.latencies.length > 500) this.latencies.shift();
        state.answer = { question, solved };
        this.revision++;
        studio.view.invalidatePose();
      } catch (error) {
        studio.toast("error", "The rig could not be evaluated", error instanceof Error ? error.message : String(error));
        state.wanted = null;
      }
    }
    state.asking = null;
  }

  private async pose(question: Question, wish: Wish): Promise<Solved> {
    const blob = await studio.connection.exchange("api/project/rig/pose", question.pack(wish));
    return readSolved(unpack<RigPosed>(blob));
  }

  /** The document has changed or may have: tracks are brought up to date when nothing is on its way to the server. */
  refresh(): void {
    const names = new Set(editor.document.rigs.map((r) => r.name));
    for (const name of this.states.keys()) if (!names.has(name)) this.states.delete(name);
    for (const data of editor.document.rigs) {
      const state = this.state(data);
      if (state.timer) clearTimeout(state.timer);
      state.timer = setTimeout(() => void this.fetchTrack(data.name), TRACK_DELAY_MS);
    }
  }

  private async fetchTrack(name: string): Promise<void> {
    const state = this.states.get(name), document = editor.document;
    const data = document.rigs.find((r) => r.name === name);
    const timeline = document.characters.find((c) => c.name === data?.character)?.timeline ?? "";
    const line = document.timelines.get(timeline);
    if (!state || !data || !line) return;
    state.timer = null;
    const { track } = state;
    if (track && track.basis.clips === document.clips && track.basis.timeline === line && track.basis.data === data) return;
    if (editor.waiting > 0 || state.fetching) {
      state.timer = setTimeout(() => void this.fetchTrack(name), TRACK_DELAY_MS);
      return;
    }
    if (!this.isKeyed(document, timeline, data)) return;
    state.fetching = true;
    try {
      const query = new URLSearchParams({ rig: name, timeline });
      const blob = await studio.connection.file(`api/project/rig/track?${query}`);
      const solved = readSolved(unpack<RigPosed>(await blob.arrayBuffer()));
      if (editor.document.clips === document.clips) {
        state.track = { basis: { clips: document.clips, timeline: line, data }, solved };
        this.revision++;
        studio.view.invalidatePose();
      } else this.refresh();
    } catch (error) {
      studio.toast("error", "The rig could not be played", error instanceof Error ? error.message : String(error));
    } finally {
      state.fetching = false;
    }
  }

  /** Whether the track of the character that is edited is that of what is shown. */
  get settled(): boolean {
    const data = this.active;
    if (!data) return true;
    const state = this.state(data);
    return !state.timer && !state.fetching && !state.asking && !state.wanted;
  }

  // ---- what a person asks of a rig ---------------------------------------------------------------------------------

  private async change(label: string, asked: RigAsked): Promise<void> {
    await editor.enqueue(async () => {
      const result = await studio.connection.post<EditResult>("api/project/rig", new Blob([JSON.stringify(asked)]));
      if (result.error) throw new Error(result.error);
      if (result.report) studio.toast("info", label, result.report);
    }, `${label}: this could not be done`);
  }

  add(character: string): Promise<void> {
    tools.bones = false; // outlines are enough to look at
    return this.change("Add rig", { type: "rig_add", character, fit: true });
  }

  fit(rig: string): Promise<void> {
    return this.change("Fit rig to motion", { type: "rig_fit", rig });
  }

  bake(rig: string): Promise<void> {
    return this.change("Bake rig to joints", { type: "rig_bake", rig });
  }

  remove(rig: string): Promise<void> {
    return this.change("Remove rig", { type: "rig_remove", rig, bake: true });
  }

  /** Left and right change places, in the pose of the controls. */
  mirror(): Promise<void> {
    return this.wish("Mirror pose", { ...NO_WISH, wish: "mirror" });
  }

  /**
   * Let the server change controls and numbers at the current time (match FK and IK, another space), and pose what has
   * changed; `more` are values that are set with it.
   */
  async wish(label: string, wish: Wish, more: ReadonlyMap<string, number> = new Map()): Promise<void> {
    const { actor } = editor, data = this.active;
    if (!actor || !data) return;
    studio.pause();
    actor.evaluate(studio.time);
    const { rig } = actor, question = new Question(data, rig, rig.pose);
    let solved: Solved;
    try {
      solved = await this.pose(question, wish);
    } catch (error) {
      studio.toast("error", label, error instanceof Error ? error.message : String(error));
      return;
    }
    const values = new Map<string, readonly number[]>();
    const before = transforms(rig.pose, rig.jointCount, rig.count), { controls, values: numbers } = solved.wished!;
    const differs = (from: number, to: number) => {
      for (let n = from; n < to; n++) if (Math.abs(controls[n] - before[n]) > 1e-9) return true;
      return false;
    };
    data.controls.forEach(({ name }, n) => {
      const o = 10 * n;
      if (differs(o, o + 3)) values.set(channelOf(name, "translation").key, [...controls.subarray(o, o + 3)]);
      if (differs(o + 3, o + 7)) values.set(channelOf(name, "rotation").key, [...controls.subarray(o + 3, o + 7)]);
      if (differs(o + 7, o + 10)) values.set(channelOf(name, "scale").key, [...controls.subarray(o + 7, o + 10)]);
    });
    data.attributes.forEach(({ name }, n) => {
      const value = more.get(name) ?? numbers[n];
      if (Math.abs(value - question.values[n]) > 1e-9) values.set(channelOf(name, "value").key, [value]);
    });
    if (values.size > 0) editor.pose(values, label, true);
  }
}

export const rigging = new Rigging();
