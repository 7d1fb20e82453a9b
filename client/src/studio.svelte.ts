// The state that the page shows, and the commands that change it. The stage itself is plain TypeScript (view/).

import { SvelteMap } from "svelte/reactivity";
import type { Animation } from "./anim/animation";
import type { Clock } from "./anim/clock";
import { sameRest } from "./anim/matching";
import type { Rig } from "./anim/rig";
import type { Envelope, GraphEntry, SceneEntry, ServerMessage } from "./generated/messages";
import { PROTOCOL } from "./generated/messages";
import { History } from "./history.svelte";
import { Connection } from "./net/connection";
import { save } from "./net/download";
import type { Blobs, Container } from "./net/container";
import { Player } from "./player.svelte";
import { loadScene, type OpenFile } from "./scene";
import type { Actor } from "./view/actor";
import type { GhostSettings } from "./view/ghosts";
import type { Theme } from "./view/palette";
import { Viewport, type Display } from "./view/viewport";

export interface Toast {
  id: number;
  kind: "error" | "info";
  title: string;
  message: string;
}

export interface Job {
  id: string;
  label: string;
  fraction: number | null;
}

const PAGES = ["view", "edit", "retarget", "play"] as const;
export type Page = (typeof PAGES)[number];

/** How much of an animation a character must have for it to be offered, and to be applied by itself. */
const OFFERED = 0.3;
const APPLIED = 0.8;

export class Studio extends Player {
  files = $state.raw<OpenFile[]>([]);
  /** What the project of the edit page is made of. */
  cast = $state.raw<OpenFile[]>([]);
  activeId = $state<string | null>(null);
  hidden = $state.raw<ReadonlySet<string>>(new Set());
  /** Actor id -> animation id. */
  performing = $state.raw<Readonly<Record<string, string | null>>>({});

  display = $state<Display>({ bones: false, axes: false, weights: false, ghosts: false, grid: true, shadows: true, follow: false });
  ghosts = $state<GhostSettings>({ before: 3, after: 3, step: 4 });
  hovered = $state(-1);
  theme = $state<Theme>("dark");
  stats = $state(false);
  help = $state(false);
  /** Rises when a morph was set by hand. */
  morphRevision = $state(0);

  /** What the window shows: files to look at, a project to edit, or a graph to play. */
  page = $state<Page>("view");
  graphs = $state.raw<GraphEntry[]>([]);
  /** The graph that is played first. */
  firstGraph = $state("");

  online = $state(true);
  everOnline = $state(false);
  settled = $state(false);
  toasts = $state.raw<Toast[]>([]);
  jobs = new SvelteMap<string, Job>();
  history = new History();

  view!: Viewport;
  connection!: Connection;
  /** Parts of the page that have messages of their own. */
  readonly messageListeners = new Set<(message: ServerMessage, container: Container<Envelope>) => void>();
  private queue: Promise<void> = Promise.resolve();
  private known = new Set<string>();
  private toastCount = 0;
  private revised = 0;

  actors = $derived((this.page === "edit" ? this.cast : this.files).flatMap((file) => file.actors));
  animations = $derived(this.files.flatMap((file) => file.animations));
  active = $derived(this.actors.find((actor) => actor.id === this.activeId) ?? null);
  animation = $derived.by(() => {
    const id = this.active ? this.performing[this.active.id] : null;
    return this.animations.find((animation) => animation.id === id) ?? null;
  });
  /** What the active character can perform, its own file's first. */
  offered = $derived.by(() => {
    const { active } = this;
    if (!active) return [];
    const own = (a: Animation) => (a.sceneId === active.sceneId ? 0 : 1);
    return this.animations
      .filter((a) => a.sceneId === active.sceneId || a.match(active.rig, active.morphNames) >= OFFERED)
      .sort((a, b) => own(a) - own(b));
  });

  attach(canvas: HTMLCanvasElement): void {
    this.view = new Viewport(canvas);
    this.view.onFrame = (time, posed) => {
      this.time = time;
      const now = performance.now();
      if (posed && (!this.playing || now - this.revised > 100)) {
        this.revised = now;
        this.revision++;
      }
      for (const listener of this.frameListeners) listener();
    };
    this.view.onStop = () => (this.playing = false);
    this.connection = new Connection(
      (message, container) => this.receive(message, container),
      (online) => {
        this.online = online;
        this.everOnline ||= online;
      },
    );
  }

  // ---- files -------------------------------------------------------------------------------------------------------

  protected clock(): Clock {
    return this.view.clock;
  }

  protected reposed(): void {
    this.view.invalidatePose();
  }

  rig(): Rig | null {
    return this.active?.rig ?? null;
  }

  private receive(message: ServerMessage, container: Container<Envelope>): void {
    for (const listener of this.messageListeners) listener(message, container);
    switch (message.type) {
      case "hello":
        if (message.protocol !== PROTOCOL) {
          this.toast("error", "This page is older than the server", "Reload the page.");
          return;
        }
        this.graphs = message.graphs;
        this.firstGraph = message.graph;
        if (!this.greeted) this.turnTo(PAGES.find((page) => location.hash === `#${page}`) ?? message.start);
        this.greeted = true;
        for (const file of this.files) if (!message.scenes.some((s) => s.id === file.id)) this.forget(file.id);
        for (const entry of message.scenes) this.open(entry);
        if (message.expected === 0) this.settled = true;
        break;
      case "graph_ready":
        this.graphs = [...this.graphs.filter((g) => g.id !== message.graph.id), message.graph];
        break;
      case "scene_ready":
        this.open(message.scene);
        break;
      case "scene_closed":
        this.forget(message.id);
        break;
      case "progress":
        if (message.done) this.jobs.delete(message.job);
        else this.jobs.set(message.job, { id: message.job, label: message.label, fraction: message.fraction });
        break;
      case "failure":
        this.toast("error", message.title, message.message);
        this.settled = true;
        break;
      case "notice":
        this.toast("info", message.title, message.message);
        break;
    }
  }

  /** Turn to a page; the one that is left stands still. */
  turnTo(page: Page): void {
    if (page !== this.page) {
      this.pause();
      this.left[this.page] = { active: this.activeId, time: this.view.clock.time };
      this.page = page;
      if (page === "view" || page === "edit") this.present(this.left[page]);
    }
    window.history.replaceState(null, "", `#${page}`);
  }
  private greeted = false;
  private readonly left: Partial<Record<Page, { active: string | null; time: number }>> = {};

  /** Bring the actors of this page onto the stage, as they were left. */
  private present(left: { active: string | null; time: number } | undefined): void {
    const { view } = this;
    view.present(this.actors);
    this.activeId = view.active = null;
    this.select(-1);
    this.activate(this.actors.find((a) => a.id === left?.active) ?? this.actors[0] ?? null);
    view.clock.time = this.time = left?.time ?? this.animation?.start ?? 0;
    for (const listener of this.pageListeners) listener(this.page);
    if (this.actors.length > 0) view.frameAll(left ? null : "three-quarter", true);
    view.invalidatePose();
  }
  /** Told of the page that the stage shows now. */
  readonly pageListeners = new Set<(page: Page) => void>();
  /** Told of every character that came onto the stage for the project. */
  readonly castListeners = new Set<() => void>();

  /** Fetch a scene: a file to look at, or a part of the project. */
  open(entry: SceneEntry, owner: "files" | "cast" = "files"): void {
    if (this.known.has(entry.id)) return;
    this.known.add(entry.id);
    const job = `scene ${entry.id}`;
    this.jobs.set(job, { id: job, label: entry.name, fraction: 0 });
    this.queue = this.queue.then(async () => {
      try {
        const container = await this.connection.scene<never>(entry.id, entry.bytes, (fraction) =>
          this.jobs.set(job, { id: job, label: entry.name, fraction }),
        );
        const file = await loadScene(container);
        if (!this.known.has(entry.id)) file.dispose();
        else if (owner === "cast") this.enterCast(file);
        else {
          this.enter(file);
          for (const listener of this.openListeners) listener(file);
        }
      } catch (error) {
        this.known.delete(entry.id);
        this.toast("error", `${entry.name} cannot be shown`, error instanceof Error ? error.message : String(error));
      } finally {
        this.jobs.delete(job);
        this.settled = true;
      }
    });
  }

  /** Names of the characters of this project that were brought into view. */
  readonly framed = new Set<string>();

  private enterCast(file: OpenFile): void {
    this.cast = [...this.cast, file];
    if (this.page === "edit") {
      for (const actor of file.actors) this.view.add(actor);
      if (!this.active) this.activate(file.actors[0] ?? null);
      // who only comes with a rig, or without it again, is looked at as before
      if (!this.framed.has(file.name)) this.view.frameAll("three-quarter", true);
    }
    this.framed.add(file.name);
    for (const listener of this.castListeners) listener();
  }

  /** Told of every file that has come, beside the characters of the project. */
  readonly openListeners = new Set<(file: OpenFile) => void>();

  private enter(file: OpenFile): void {
    const first = this.files.length === 0;
    this.files = [...this.files, file];
    if (this.page === "edit") {
      // it is looked at on the other page; here it can be taken into the project
      for (const actor of file.actors) this.give(actor, file.animations.find((a) => a.match(actor.rig, actor.morphNames) >= OFFERED) ?? null);
      if (this.settled) this.toast("info", `${file.name} is open`, "Add its character with + beside Characters, or import its animation from the project menu.");
      return;
    }
    for (const actor of file.actors) {
      const own = file.animations.find((a) => a.match(actor.rig, actor.morphNames) >= OFFERED);
      const borrowed = actor.hasMesh
        ? this.animations.find((a) => a.sceneId !== file.id && this.fits(a, actor))
        : undefined;
      this.give(actor, borrowed ?? own ?? null);
      this.view.add(actor);
    }
    const resized = file.actors.find((actor) => actor.scale !== 1) ?? this.actors.find((actor) => actor.scale !== 1);
    if (resized && !this.toldScale) {
      this.toldScale = true;
      this.toast("info", "Shown at one size", "The characters differ so much in size that they are shown equally tall. All numbers are real.");
    }
    if (file.actors.length > 0 && !file.hasMesh) this.lend(file);
    if (first && file.actors.length > 0) {
      this.activate(file.actors[0]);
      if (this.page === "view" && this.animation && !matchMedia("(prefers-reduced-motion: reduce)").matches) this.play();
    }
    if (file.actors.length > 0) this.view.frameAll("three-quarter", first);
    if (file.actors.length === 0) this.toast("info", `${file.name} holds nothing to show`, "It has no character and no skeleton.");
  }

  /**
   * Whether an animation of a file without a mesh is meant for a character: it has the joints by name, and the two rest
   * poses agree, so that it looks right without retargeting. What does not fit is still offered in the list of clips.
   */
  private fits(animation: Animation, actor: Actor): boolean {
    const file = this.files.find((f) => f.id === animation.sceneId);
    const source = file && !file.hasMesh ? file.actors[0] : undefined;
    return source !== undefined && animation.match(actor.rig, actor.morphNames) >= APPLIED && sameRest(source.rig, actor.rig);
  }

  /** A new performance goes to every character that it fits. */
  private lend(file: OpenFile): void {
    for (const actor of this.actors) {
      if (!actor.hasMesh || actor.sceneId === file.id) continue;
      const animation = file.animations.find((a) => this.fits(a, actor));
      if (animation) this.perform(actor, animation);
    }
  }

  forget(id: string): void {
    this.known.delete(id);
    const file = [...this.files, ...this.cast].find((f) => f.id === id);
    if (!file) return;
    for (const actor of file.actors) this.view.remove(actor);
    file.dispose();
    this.files = this.files.filter((f) => f !== file);
    this.cast = this.cast.filter((f) => f !== file);
    for (const actor of this.actors) if (actor.animation?.sceneId === id) this.perform(actor, null);
    if (!this.active) this.activate(this.actors[0] ?? null);
    if (this.actors.length > 0) this.view.frameAll();
  }

  openSample(name: string): void {
    this.connection.send({ type: "open_sample", name });
  }

  close(id: string): void {
    this.connection.send({ type: "close_scene", id });
    this.forget(id);
  }

  /** Told when an upload has ended, however it did. */
  readonly uploadListeners = new Set<() => void>();

  async upload(files: Blobs[]): Promise<void> {
    if (files.length === 0) return;
    const job = `sending ${files[0].name}`;
    this.jobs.set(job, { id: job, label: `Sending ${files[0].name}`, fraction: null });
    try {
      const result = await this.connection.upload(files);
      if (result.graphs.length > 0) {
        this.firstGraph = result.graphs[result.graphs.length - 1].id;
        this.turnTo("play");
      }
      for (const error of result.errors) this.toast("error", "This file cannot be read", error);
    } catch {
      this.toast("error", "The file did not arrive", "The studio's server cannot be reached. Is keypose still running?");
    } finally {
      this.jobs.delete(job);
      for (const listener of this.uploadListeners) listener();
    }
  }

  // ---- who performs what -------------------------------------------------------------------------------------------

  activate(actor: Actor | null): void {
    if (this.activeId === (actor?.id ?? null)) return;
    this.activeId = actor?.id ?? null;
    this.view.active = actor;
    this.select(-1);
    this.takePace(false);
  }

  private give(actor: Actor, animation: Animation | null): void {
    actor.setAnimation(animation);
    actor.measurePerformance();
    this.performing = { ...this.performing, [actor.id]: animation?.id ?? null };
  }

  perform(actor: Actor, animation: Animation | null): void {
    this.give(actor, animation);
    this.view.arrange();
    this.view.applyDisplay();
    if (actor.id === this.activeId) this.takePace(true);
  }

  /** The active character's animation sets the range and the rate. */
  private takePace(restart: boolean): void {
    if (this.page === "edit") return;
    const { clock } = this.view;
    const { animation } = this;
    clock.rate = animation?.rate ?? 30;
    if (restart || !animation || clock.time < animation.start || clock.time > animation.end) clock.time = animation?.start ?? 0;
    this.setRange(animation?.start ?? 0, animation?.end ?? 0);
    this.view.invalidatePose();
    // until the user decides, the camera follows who walks away
    if (!this.followChosen && this.active) this.show("follow", this.active.travel() > 0.6 * this.active.height);
  }
  private followChosen = false;
  private toldScale = false;

  toggleFollow(): void {
    this.followChosen = true;
    this.show("follow");
  }

  stepClip(direction: number): void {
    const { offered, active, animation } = this;
    if (!active || offered.length === 0) return;
    const at = animation ? offered.indexOf(animation) : direction > 0 ? -1 : 0;
    this.perform(active, offered[(at + direction + offered.length) % offered.length]);
  }

  toggleHidden(actor: Actor): void {
    const hidden = new Set(this.hidden);
    if (!hidden.delete(actor.id)) hidden.add(actor.id);
    this.hidden = hidden;
    actor.setVisible(!hidden.has(actor.id));
    this.view.applyDisplay();
  }

  // ---- looking -----------------------------------------------------------------------------------------------------

  show(name: keyof Display, shown = !this.display[name]): void {
    this.display[name] = shown;
    this.applyDisplay();
  }

  setGhosts(change: Partial<GhostSettings>): void {
    Object.assign(this.ghosts, change);
    this.applyDisplay();
  }

  private applyDisplay(): void {
    this.view.display = { ...this.display };
    this.view.ghostSettings = { ...this.ghosts };
    this.view.applyDisplay();
  }

  select(joint: number): void {
    this.selected = this.view.selected = joint;
    this.view.paintJoints();
  }

  hover(joint: number): void {
    if (joint === this.hovered) return;
    this.hovered = this.view.hovered = joint;
    this.view.paintJoints();
  }

  setTheme(theme: Theme, remember = true): void {
    this.theme = theme;
    document.documentElement.dataset.theme = theme;
    this.view.setTheme(theme);
    try {
      if (remember) localStorage.setItem("keypose.theme", theme);
    } catch {
      // a browser that forbids storage forgets the theme; nothing else depends on it
    }
    for (const listener of this.frameListeners) listener();
  }

  async screenshot(): Promise<void> {
    const blob = await this.view.screenshot();
    const frame = Math.round((this.view.clock.time - (this.animation?.start ?? 0)) * this.rate);
    const name = [this.active?.name ?? "stage", this.animation?.name].filter(Boolean).join("-").replace(/[^\w.-]+/g, "_");
    save(blob, `${name}-${String(frame).padStart(4, "0")}.png`);
  }

  // ---- morphs ------------------------------------------------------------------------------------------------------

  setMorph(actor: Actor, channel: number, weight: number): void {
    const before = actor.morphOverrides[channel];
    const assign = (value: number) => () => {
      actor.morphOverrides[channel] = value;
      this.morphsChanged();
    };
    assign(weight)();
    const name = actor.morphNames[channel];
    this.history.push(`${name}`, `morph ${actor.id} ${channel}`, assign(before), assign(weight));
  }

  resetMorphs(actor: Actor, channels: number[]): void {
    const before = actor.morphOverrides.slice();
    const assign = (values: (m: number) => number) => () => {
      for (const m of channels) actor.morphOverrides[m] = values(m);
      this.morphsChanged();
    };
    const clear = assign(() => NaN);
    if (channels.every((m) => Number.isNaN(before[m]))) return;
    clear();
    this.history.push("reset of morphs", "", assign((m) => before[m]), clear);
  }

  private morphsChanged(): void {
    this.morphRevision++;
    this.view.invalidatePose();
  }

  // ---- messages ----------------------------------------------------------------------------------------------------

  toast(kind: Toast["kind"], title: string, message: string): void {
    const toast = { id: ++this.toastCount, kind, title, message };
    this.toasts = [...this.toasts.slice(-4), toast];
    setTimeout(() => this.dismiss(toast.id), kind === "error" ? 14_000 : 6_000);
  }

  dismiss(id: number): void {
    this.toasts = this.toasts.filter((t) => t.id !== id);
  }
}

export const studio = new Studio();
