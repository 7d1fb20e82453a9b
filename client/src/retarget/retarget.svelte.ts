// The state of the retarget page and its commands: two subjects, what is asked of the server, and what came of it.

import type { Animation } from "../anim/animation";
import { Clock } from "../anim/clock";
import type { Rig } from "../anim/rig";
import type { RetargetAsked, RetargetDone, RetargetRoles, RetargetSubject } from "../generated/messages";
import { History } from "../history.svelte";
import { save } from "../net/download";
import { Player } from "../player.svelte";
import { loadScene, type OpenFile } from "../scene";
import { studio } from "../studio.svelte";
import type { Actor } from "../view/actor";
import { SIDES, type Look, type Pair, type SideName } from "./pair";
import type { Print } from "./prints";
import { assigned, fromJson, labelOf, mirrored, missingOf, toJson, type RoleTable } from "./roles";
import { discard, mostHuman, PLAIN, requestOf, sameRig, standsAtRest, stem, type Options, type Prop, type Stand, type Subject } from "./subjects";

const SETTLE_MS = 140;

/** What the files that are sent now are for: one of the two bodies, its stand, or a result to set beside. */
interface Expected {
  readonly side: SideName;
  readonly as: "subject" | "stand" | "against";
}

export class Retarget extends Player {
  subjects = $state.raw<Readonly<Record<SideName, Subject | null>>>({ source: null, target: null });
  loading = $state.raw<Readonly<Record<SideName, string>>>({ source: "", target: "" });
  /** Roles set by hand; null for what was found. */
  maps = $state.raw<Readonly<Record<SideName, RoleTable | null>>>({ source: null, target: null });
  options = $state<Options>({ ...PLAIN });
  look = $state<Look>({ bones: false, surface: "shaded", grid: true, follow: false, prints: true, linked: true });
  tab = $state<"fit" | "roles">("fit");
  panel = $state(innerWidth > 900);
  /** Whether changes are carried out at once. */
  automatic = $state(true);

  done = $state.raw<RetargetDone | null>(null);
  /** Why there is no motion. */
  error = $state("");
  busy = $state(false);
  /** Something was changed since `done`. */
  stale = $state(false);
  saving = $state("");

  /** Whose roles are chosen, and which. */
  side = $state<SideName>("target");
  role = $state<string | null>(null);
  hoveredRole = $state<string | null>(null);
  hoveredJoint = $state(-1);
  /** Whether the one whose roles are chosen stands in its rest pose. */
  atRest = $state(true);
  readonly history = new History();

  animation = $derived.by((): Animation | null => {
    const { source } = this.subjects;
    return source?.file.animations[source.animation] ?? null;
  });
  picking = $derived<SideName | null>(this.tab === "roles" && this.panel ? this.side : null);

  private pair: Pair | null = null;
  private readonly idle = new Clock();
  private result: Animation | null = null;
  private readonly turns: Record<SideName, number> = { source: 0, target: 0 };
  private run = 0;
  private again = false;
  private timer: ReturnType<typeof setTimeout> | undefined;
  private entered = false;
  private followChosen = false;
  private expecting: Expected | null = null;
  /** Ids of files on their way that are no body of this page, and what they are for. */
  private readonly awaited = new Map<string, Expected>();
  private framed = "";
  private revised = 0;

  // ---- the player --------------------------------------------------------------------------------------------------

  protected clock(): Clock {
    return this.pair?.clock ?? this.idle;
  }

  protected reposed(): void {
    this.pair?.reposed();
  }

  rig(): Rig | null {
    return this.actor("source")?.rig ?? null;
  }

  // ---- the stages --------------------------------------------------------------------------------------------------

  attach(pair: Pair | null): void {
    this.pair = pair;
    if (!pair) return;
    pair.onFrame = (time, posed) => {
      this.time = time;
      const now = performance.now();
      if (posed && (!this.playing || now - this.revised > 100)) {
        this.revised = now;
        this.revision++;
      }
      for (const listener of this.frameListeners) listener();
    };
    pair.onStop = () => (this.playing = false);
    pair.setTheme(studio.theme);
  }

  get stages(): Pair | null {
    return this.pair;
  }

  actor(side: SideName): Actor | null {
    const subject = this.subjects[side];
    return subject?.file.actors[subject.character] ?? null;
  }

  /** Begin with what is open, when the page is first seen. */
  enter(): void {
    if (this.entered || !this.pair) return;
    this.entered = true;
    studio.messageListeners.add((message) => {
      if (message.type === "scene_ready" && studio.page === "retarget") void this.adopt(message.scene.id);
    });
    studio.openListeners.add((file) => {
      const wanted = this.awaited.get(file.id);
      if (wanted && this.awaited.delete(file.id)) this.adoptBeside(file, wanted);
    });
    // what was opened is announced at about the same time as the upload's end
    studio.uploadListeners.add(() => setTimeout(() => (this.expecting = null), 1000));
    const files = studio.files.filter((file) => file.actors.length > 0);
    const moving = files.filter((file) => file.animations.length > 0);
    const source = moving.find((file) => !file.hasMesh) ?? (files.length === 1 ? moving[0] : undefined) ?? moving.find((file) => files.some((other) => other !== file && other.hasMesh));
    void this.choose("source", source?.id ?? "sample:walk");
    void this.findTarget(files.filter((file) => file.hasMesh && file !== source));
  }

  /** The first of these that is a person, else the first; the built-in one where there are none. */
  private async findTarget(files: readonly OpenFile[]): Promise<void> {
    const turn = this.turns.target;
    let found = files[0]?.id ?? "sample:human";
    for (const { id } of files.length > 1 ? files : []) {
      const told = await this.ask<RetargetSubject>({ type: "retarget_subject", scene: id });
      if (!told.characters.some((one) => one.missing.length === 0 && !one.all_fours)) continue;
      found = id;
      break;
    }
    if (turn === this.turns.target) await this.choose("target", found);
  }

  // ---- subjects ----------------------------------------------------------------------------------------------------

  /** The files that are sent now are for this side. */
  expect(side: SideName, as: Expected["as"] = "subject"): void {
    this.expecting = { side, as };
  }

  private async fetched(reference: string, side: SideName | null): Promise<{ told: RetargetSubject; file: OpenFile } | null> {
    const told = await this.ask<RetargetSubject>({ type: "retarget_subject", scene: reference });
    if (!told.scene) throw new Error(told.error);
    const container = await studio.connection.scene<never>(told.scene.id, told.scene.bytes, (fraction) => {
      if (side) this.loading = { ...this.loading, [side]: `Loading ${told.scene!.name}: ${Math.round(100 * fraction)} %` };
    });
    return { told, file: await loadScene(container) };
  }

  /** A file that was opened while this page is seen takes the side that it was dropped on, or that suits it. */
  private async adopt(reference: string): Promise<void> {
    const wanted = this.expecting?.as === "subject" ? this.expecting.side : null;
    try {
      if (this.expecting && this.expecting.as !== "subject") {
        this.awaited.set(reference, this.expecting);
        return;
      }
      const found = await this.fetched(reference, null);
      if (!found || found.file.actors.length === 0) return;
      const { hasMesh, animations, name } = found.file, moves = animations.length > 0;
      // the skeleton file of a motion comes along with it
      if (!moves && !hasMesh && wanted === "source") {
        discard(found.file);
        return;
      }
      const side = !moves ? "target" : (wanted ?? (hasMesh ? "target" : "source"));
      if (wanted === "source" && !moves) studio.toast("info", `${name} has no motion`, "It is taken as the character that the motion goes to.");
      this.turns[side]++; // what was on its way there comes too late
      this.loading = { ...this.loading, [side]: "" };
      this.take(side, reference, found.told, found.file);
    } catch (error) {
      this.refuse(reference, error);
    }
  }

  /** A file that was opened for how a body stands, or to set this result beside. */
  private adoptBeside(file: OpenFile, { side, as }: Expected): void {
    const moves = file.animations.length > 0, actor = this.actor(side);
    if (as === "against" && moves && file.actors.length > 0) this.set({ against: file.id });
    else if (as === "stand" && actor && file.actors.length > 0 && sameRig(file.actors[0].rig, actor.rig)) this.setStand(side, this.momentOf(file));
    else studio.toast("info", `${file.name} does not fit`, as === "against" ? "It has no motion to compare with." : "Its skeleton is of another rig: not even half of the joints have the same names.");
  }

  async choose(side: SideName, reference: string): Promise<void> {
    const turn = ++this.turns[side];
    this.loading = { ...this.loading, [side]: "Loading" };
    try {
      const found = await this.fetched(reference, side);
      if (!found) return;
      if (turn !== this.turns[side]) discard(found.file);
      else this.take(side, reference, found.told, found.file);
    } catch (error) {
      if (turn === this.turns[side]) this.refuse(reference, error);
    } finally {
      if (turn === this.turns[side]) this.loading = { ...this.loading, [side]: "" };
    }
  }

  private refuse(reference: string, error: unknown): void {
    studio.toast("error", `${reference.replace("sample:", "")} cannot be shown`, error instanceof Error ? error.message : String(error));
  }

  private take(side: SideName, reference: string, told: RetargetSubject, file: OpenFile): void {
    if (file.actors.length === 0) {
      discard(file);
      this.refuse(file.name, new Error("It has no character and no skeleton."));
      return;
    }
    if (side === "source" && file.animations.length === 0) {
      discard(file);
      this.refuse(file.name, new Error("It has no motion."));
      return;
    }
    const old = this.subjects[side];
    const { character, animation } = mostHuman(side, told.characters, file);
    this.put(side, { reference, name: file.name.replace(/^sample:/, ""), file, found: told.characters, character, animation });
    if (old) discard(old.file);
  }

  /** Another character or animation of the same scene. */
  change(side: SideName, part: { character?: number; animation?: number }): void {
    const subject = this.subjects[side];
    if (subject) this.put(side, { ...subject, ...part });
  }

  private put(side: SideName, subject: Subject): void {
    const before = this.subjects[side];
    const same = before?.file === subject.file && before.character === subject.character;
    this.subjects = { ...this.subjects, [side]: subject };
    if (!same) {
      this.maps = { ...this.maps, [side]: null };
      this.history.clear();
      this.role = null;
      if (side === "source") this.followChosen = false;
    }
    if (side === "source") this.takePace();
    // a moment of another motion, or of another rig, says nothing of this one
    if (this.options.stands[side].kind === "moment") this.options.stands = { ...this.options.stands, [side]: PLAIN.stands[side] };
    // the old motion is no longer that of these two
    this.result = null;
    this.done = null;
    this.error = "";
    this.fitted[side] = same ? this.fitted[side] : "gone";
    this.perform();
    const actor = this.actor("source");
    if (side === "source" && actor && !this.followChosen) this.look.follow = actor.travel() > 0.6 * actor.height;
    if (!same) {
      this.atRest = this.side === side ? standsAtRest(this.actor(side)?.rig ?? null, this.table(side), this.found(side)) : this.atRest;
      this.applyLook();
      this.pair?.show(side, this.actor(side));
    }
    this.request(true);
  }

  private takePace(): void {
    const clock = this.clock(), { animation } = this;
    clock.rate = animation?.rate ?? 30;
    clock.time = animation?.start ?? 0;
    this.setRange(animation?.start ?? 0, animation?.end ?? 0);
  }

  /** Everybody performs what is to be seen now. */
  perform(): void {
    const shown: Record<SideName, Animation | null> = { source: this.animation, target: this.result };
    for (const side of SIDES) {
      const actor = this.actor(side);
      if (!actor) continue;
      const wanted = this.picking === side && this.atRest ? null : shown[side];
      if (actor.animation !== wanted) {
        actor.setAnimation(wanted);
        actor.measurePerformance();
      }
    }
    this.fitPrints();
    this.pair?.reposed();
  }

  /** The prints of the feet, once for each motion; who stands at rest shows none. */
  private fitPrints(): void {
    const { done, pair } = this;
    if (!pair) return;
    let changed = false;
    for (const side of SIDES) {
      const animation = this.actor(side)?.animation ?? null;
      const motion = done && animation ? animation : null;
      if (motion === null && done && animation === null) continue;
      const key = motion && done ? `${done.id} ${side}` : "";
      if (key === this.fitted[side]) continue;
      this.fitted[side] = key;
      changed = true;
      pair.steps(side, done && motion ? done.feet : [], motion?.start ?? 0, done?.rate_hz ?? 1);
    }
    if (changed) this.prints = { source: pair.prints.source.prints, target: pair.prints.target.prints };
  }
  private readonly fitted: Record<SideName, string> = { source: "", target: "" };
  /** When the feet of both are on the ground, and how they slide there. */
  prints = $state.raw<Readonly<Record<SideName, readonly Print[]>>>({ source: [], target: [] });

  // ---- asking ------------------------------------------------------------------------------------------------------

  private async ask<R>(asked: RetargetAsked): Promise<R> {
    return studio.connection.post<R>("api/retarget", new Blob([JSON.stringify(asked)]));
  }

  /** What is set has changed: carry it out soon, or, where changes wait for a click, remember it. */
  request(now = false): void {
    this.stale = true;
    if (!this.automatic && !now) return;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => void this.retarget(), now ? 0 : SETTLE_MS);
  }

  async retarget(): Promise<void> {
    clearTimeout(this.timer);
    const { source, target } = this.subjects;
    if (!source || !target) return;
    if (this.busy) {
      this.again = true;
      return;
    }
    const run = ++this.run;
    this.busy = true;
    this.stale = false;
    try {
      const done = await this.ask<RetargetDone>(requestOf(source, target, this.options, this.maps));
      if (this.subjects.source !== source || this.subjects.target !== target) return;
      if (!done.scene) {
        this.fail(done.error);
        return;
      }
      const file = await loadScene(await studio.connection.scene<never>(done.scene.id, done.scene.bytes, () => {}));
      if (this.subjects.source !== source || this.subjects.target !== target || run !== this.run) return;
      this.show(done, file.animations[0]);
    } catch (error) {
      this.fail(error instanceof TypeError ? "The studio's server cannot be reached. Is keypose still running?" : error instanceof Error ? error.message : String(error));
    } finally {
      this.busy = false;
      if (this.again) {
        this.again = false;
        void this.retarget();
      }
    }
  }

  private fail(error: string): void {
    this.error = error;
    this.done = null;
    this.result = null;
    this.pair?.showProps([]);
    this.perform();
  }

  private show(done: RetargetDone, animation: Animation): void {
    this.done = done;
    this.error = "";
    this.result = animation;
    this.pair?.showProps(done.props);
    this.perform();
    const pairName = `${this.subjects.source!.file.id} ${this.subjects.source!.animation} ${this.subjects.target!.file.id}`;
    if (this.framed === pairName) return;
    this.framed = pairName;
    this.pair?.frame("three-quarter", true);
    if (!this.playing && !matchMedia("(prefers-reduced-motion: reduce)").matches && studio.page === "retarget") this.play();
  }

  // ---- options -----------------------------------------------------------------------------------------------------

  set(change: Partial<Options>): void {
    Object.assign(this.options, change);
    this.request();
  }

  resetOptions(): void {
    this.set({ ...PLAIN });
  }

  get isPlain(): boolean {
    return JSON.stringify(this.options) === JSON.stringify(PLAIN);
  }

  setStand(side: SideName, stand: Stand): void {
    this.set({ stands: { ...this.options.stands, [side]: stand } });
  }

  /** How somebody stands in a file: in its first frame, or at rest where it has no motion. */
  momentOf(file: OpenFile): Stand {
    return { kind: "moment", scene: file.id, name: file.name, time: this.firstTime(file.id), rate: file.animations[0]?.rate ?? 30 };
  }

  /** When the motion of an open file begins; null where it has none. */
  firstTime(scene: string): number | null {
    return studio.files.find((file) => file.id === scene)?.animations[0]?.start ?? null;
  }

  /** Something that hands hold on to, where a hand of the source is now. */
  addProp(role: "left_hand" | "right_hand"): void {
    const actor = this.actor("source"), joint = this.table("source")[role];
    const index = actor && joint !== undefined ? actor.rig.index(joint) : -1;
    if (!actor || index < 0) {
      studio.toast("info", `${labelOf(role)} is not known`, "Say on the Roles tab which joint it is.");
      return;
    }
    actor.evaluate(this.now);
    const { x, y, z } = actor.jointPosition(index, actor.measuredRoot.clone());
    const round = (n: number) => Math.round(1000 * n) / 1000;
    this.set({ props: [...this.options.props, { source: [round(x), round(y), round(z)], target: null }] });
  }

  changeProp(at: number, prop: Prop): void {
    this.set({ props: this.options.props.map((old, n) => (n === at ? prop : old)) });
  }

  removeProp(at: number): void {
    this.set({ props: this.options.props.filter((_, n) => n !== at) });
  }

  // ---- looking -----------------------------------------------------------------------------------------------------

  toggle3d(name: "bones" | "grid" | "follow" | "prints" | "linked"): void {
    this.look[name] = !this.look[name];
    if (name === "follow") this.followChosen = true;
    this.applyLook();
  }

  nextSurface(): void {
    const all = ["shaded", "wire", "none"] as const;
    this.look.surface = all[(all.indexOf(this.look.surface) + 1) % all.length];
    this.applyLook();
  }

  applyLook(): void {
    this.pair?.setLook({ ...this.look }, this.picking);
    if (this.picking) this.mark();
  }

  // ---- roles -------------------------------------------------------------------------------------------------------

  found(side: SideName): RetargetRoles | null {
    const subject = this.subjects[side];
    return subject?.found[subject.character] ?? null;
  }

  /** The roles that count: set by hand, else found. */
  table(side: SideName): RoleTable {
    return this.maps[side] ?? this.found(side)?.roles ?? {};
  }

  missing(side: SideName): string[] {
    return missingOf(this.table(side));
  }

  pick(side: SideName): void {
    this.side = side;
    this.role = this.hoveredRole = null;
    this.hoveredJoint = -1;
    this.atRest = standsAtRest(this.actor(side)?.rig ?? null, this.table(side), this.found(side));
    this.showPicking();
  }

  /** To the roles of the body whose joints cannot all be told. */
  nameJoints(): void {
    this.panel = true;
    this.tab = "roles";
    this.pick(SIDES.find((side) => this.missing(side).length > 0) ?? this.side);
  }

  /** Bring the stages in line with whether roles are chosen, and whose. */
  showPicking(): void {
    this.perform();
    this.applyLook();
    const { pair, picking } = this;
    if (pair) pair.frame(picking ? "front" : "three-quarter", true);
  }

  setAtRest(on: boolean): void {
    this.atRest = on;
    this.showPicking();
  }

  /** The joints of the chosen body that stand out. */
  mark(): void {
    const { picking, pair } = this;
    const rig = picking && this.actor(picking)?.rig;
    if (!picking || !pair || !rig) return;
    const table = this.table(picking);
    const index = (role: string | null) => (role !== null && table[role] !== undefined ? rig.index(table[role]) : -1);
    pair.mark(picking, this.hoveredJoint >= 0 ? this.hoveredJoint : index(this.hoveredRole), index(this.role));
  }

  hoverRole(role: string | null): void {
    if (role === this.hoveredRole) return;
    this.hoveredRole = role;
    this.mark();
  }

  hoverJoint(joint: number): void {
    if (joint === this.hoveredJoint) return;
    this.hoveredJoint = joint;
    this.mark();
  }

  chooseRole(role: string | null): void {
    this.role = role === this.role ? null : role;
    this.mark();
  }

  roleOfJoint(joint: string): string | null {
    return Object.entries(this.table(this.side)).find(([, j]) => j === joint)?.[0] ?? null;
  }

  /** A joint was clicked: it plays the chosen role, or, where none is chosen, its own role is. */
  clickJoint(joint: string): void {
    if (this.role === null) this.chooseRole(this.roleOfJoint(joint));
    else if (this.table(this.side)[this.role] !== joint) this.assign(this.role, joint);
  }

  assign(role: string, joint: string | null): void {
    this.setMap(this.side, assigned(this.table(this.side), role, joint), joint === null ? `${labelOf(role)} without a joint` : `${labelOf(role)} is ${joint}`);
  }

  mirror(from: "left" | "right"): void {
    const rig = this.actor(this.side)?.rig;
    if (rig) this.setMap(this.side, mirrored(this.table(this.side), from, rig), `Roles mirrored from the ${from}`);
  }

  resetRoles(): void {
    this.setMap(this.side, null, "Roles as found");
  }

  /** Find the other roles anew around those that were set by hand. */
  async findRest(): Promise<void> {
    const { side } = this, subject = this.subjects[side], own = this.maps[side], found = this.found(side);
    if (!subject || !own || !found) return;
    const known = Object.fromEntries(Object.entries(own).filter(([role, joint]) => found.roles[role] !== joint));
    try {
      const told = await this.ask<RetargetRoles>({ type: "retarget_roles", scene: subject.reference, character: subject.character, known });
      if (this.subjects[side] === subject) this.setMap(side, told.roles, "Other roles found anew");
    } catch (error) {
      studio.toast("error", "No roles were found", error instanceof Error ? error.message : String(error));
    }
  }

  private setMap(side: SideName, table: RoleTable | null, label: string): void {
    const before = this.maps[side];
    if (before === table || (before && table && toJson(before) === toJson(table))) return;
    const apply = (value: RoleTable | null) => () => {
      this.maps = { ...this.maps, [side]: value };
      this.mark();
      this.request();
    };
    apply(table)();
    this.history.push(label, "", apply(before), apply(table));
  }

  saveMap(): void {
    const subject = this.subjects[this.side];
    if (subject) save(new Blob([toJson(this.table(this.side))], { type: "application/json" }), `${stem(subject.name)}-roles.json`);
  }

  loadMap(text: string, name: string): void {
    const rig = this.actor(this.side)?.rig;
    if (!rig) return;
    try {
      this.setMap(this.side, fromJson(text, rig.names), `Roles of ${name}`);
    } catch (error) {
      studio.toast("error", `${name} is no map for this skeleton`, error instanceof Error ? error.message : String(error));
    }
  }
}

export const retarget = new Retarget();
