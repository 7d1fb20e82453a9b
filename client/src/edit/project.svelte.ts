// The project that the server holds: what it says of it, and what the page asks.

import type {
  ChannelData,
  EditCommand,
  EditRequest,
  EditResult,
  Envelope,
  OperateRequest,
  ProjectChanged,
  ProjectFolder,
  ProjectNotSaved,
  ProjectState,
  ProjectStatus,
  Recoverable,
  ServerMessage,
} from "../generated/messages";
import { Packer, type Container } from "../net/container";
import { save } from "../net/download";
import { studio } from "../studio.svelte";
import type { Changes, ChannelId, EditDocument } from "./contract";
import { EMPTY } from "./document";
import { editor } from "./editor.svelte";
import type { Link, Scope, Values } from "./link";
import { operators } from "./operators.svelte";
import { commandsOf, readChanged, readState } from "./wire";

export type Dialog = "new" | "open" | "save" | "recover" | "export" | "character" | "clip";
/** What waits for an answer to "there are unsaved changes". */
export interface Guarded {
  readonly what: string;
  readonly go: (discard: boolean) => void;
}

export class Project implements Link {
  status = $state.raw<ProjectStatus | null>(null);
  recoverable = $state.raw<readonly Recoverable[]>([]);
  operators = $state.raw<readonly string[]>([]);
  exports = $state.raw<readonly string[]>([]);
  settings = $state.raw<Readonly<Record<string, string | number | boolean>>>({});
  folder = $state("");
  dialog = $state<Dialog | null>(null);
  guarded = $state.raw<Guarded | null>(null);
  listing = $state.raw<ProjectFolder | null>(null);
  notSaved = $state.raw<ProjectNotSaved | null>(null);
  /** Labels of the steps that this page has seen, oldest first, and of those that were taken back, next first. */
  past = $state.raw<readonly string[]>([]);
  future = $state.raw<readonly string[]>([]);

  private document: EditDocument = EMPTY;
  private watching = false;
  private offered = false;
  private count = 0;
  private readonly page = Math.random().toString(36).slice(2, 10);
  private awaited: { cause: string; done: () => void }[] = [];

  constructor() {
    studio.messageListeners.add((message, container) => this.receive(message, container));
    editor.link = this;
  }

  unsaved = $derived(this.status !== null && this.status.revision !== this.status.saved_revision);

  /** From the first look at the editor on, the page follows the project. */
  watch(): void {
    if (this.watching) return;
    this.watching = true;
    studio.connection.send({ type: "project_watch" });
  }

  private receive(message: ServerMessage, container: Container<Envelope>): void {
    switch (message.type) {
      case "hello":
        if (this.watching) studio.connection.send({ type: "project_watch" });
        break;
      case "project_state":
        this.enter(message, container);
        break;
      case "project_changed":
        this.change(message, container);
        break;
      case "project_folder":
        this.listing = message;
        break;
      case "project_not_saved":
        this.notSaved = message;
        this.settle("save");
        break;
    }
  }

  private enter(state: ProjectState, container: Container<Envelope>): void {
    const same = this.status !== null && this.status.name === state.status.name && this.status.path === state.status.path;
    const scenes = new Set(state.characters.map((c) => c.scene.id));
    for (const { scene } of this.document.characters) if (!scenes.has(scene)) studio.forget(scene);
    for (const { scene } of state.characters) studio.open(scene, "cast");
    this.document = readState(state, container);
    this.status = state.status;
    this.recoverable = state.recoverable;
    this.operators = state.operators;
    this.exports = state.exports;
    this.settings = state.settings;
    this.folder = state.folder;
    if (!same || state.status.undo === "") this.past = [];
    if (!same || state.status.redo === "") this.future = [];
    this.settle("");
    editor.take(this.document, same, state.status.revision);
    if (!this.offered && state.recoverable.length > 0 && this.document.characters.length === 0) {
      this.dialog = "recover";
      this.offered = true;
    }
  }

  private change(change: ProjectChanged, container: Container<Envelope>): void {
    const { status } = this;
    // a step that this page has missed cannot be built upon: ask for the whole
    if (!status || (change.cause !== "save" && change.status.revision !== status.revision + 1)) {
      if (status && change.status.revision <= status.revision) return;
      studio.connection.send({ type: "project_watch" });
      return;
    }
    const before = this.document;
    this.document = readChanged(before, change, container);
    this.status = change.status;
    if (change.settings) this.settings = change.settings;
    if (change.characters) {
      const scenes = new Set(change.characters.map((c) => c.scene.id));
      for (const { scene } of before.characters) if (!scenes.has(scene)) studio.forget(scene);
      for (const { scene } of change.characters) studio.open(scene, "cast");
    }
    this.remember(change);
    editor.confirm(this.document, change.edit, change.status.revision);
    this.settle(change.cause);
  }

  private remember({ cause, label }: ProjectChanged): void {
    if (cause === "edit") {
      this.past = [...this.past, label];
      this.future = [];
    } else if (cause === "undo") {
      this.past = this.past.slice(0, -1);
      this.future = [label, ...this.future];
    } else if (cause === "redo") {
      this.past = [...this.past, label];
      this.future = this.future.slice(1);
    } else {
      this.notSaved = null;
      studio.toast("info", "Saved", fileName(this.status!.path));
    }
  }

  /** What waited for the server to have done something goes on. */
  private settle(cause: string): void {
    const found = this.awaited.filter((a) => cause === "" || a.cause === cause);
    const next = cause === "" ? found : found.slice(0, 1);
    this.awaited = this.awaited.filter((a) => !next.includes(a));
    next.forEach((a) => a.done());
  }

  private until(cause: string): Promise<void> {
    return new Promise((done) => {
      const waiting = { cause, done };
      this.awaited.push(waiting);
      setTimeout(() => {
        this.awaited = this.awaited.filter((a) => a !== waiting);
        done();
      }, 10_000);
    });
  }

  // ---- edits -------------------------------------------------------------------------------------------------------

  private async post(path: string, packer: Packer, header: EditRequest | OperateRequest): Promise<EditResult> {
    const result = await studio.connection.post<EditResult>(path, packer.pack(header));
    if (result.error) throw new Error(result.error);
    return result;
  }

  newId(): string {
    return `${this.page}-${++this.count}`;
  }

  async commit(id: string, label: string, changes: Changes): Promise<number> {
    const packer = new Packer();
    const header: EditRequest = { type: "edit", id, label, merge: "", commands: commandsOf(packer, changes) };
    return (await this.post("api/project/edit", packer, header)).revision;
  }

  /** Commands that the page does not show before they are done. */
  ask(label: string, ...commands: EditCommand[]): Promise<void> {
    const header: EditRequest = { type: "edit", id: this.newId(), label, merge: "", commands };
    return editor.enqueue(async () => void (await this.post("api/project/edit", new Packer(), header)), `“${label}” was not accepted`);
  }

  async operate(name: string, scope: Scope, parameters: Values): Promise<void> {
    const packer = new Packer();
    const channels = [...scope.channels].map(([key, keys]) => {
      const [target, property, component] = key.split("\u0000");
      const channel: ChannelData = { target, property: property as ChannelId["property"], component: component === "" ? null : Number(component) };
      return { channel, keys: keys && packer.add(keys) };
    });
    const { report } = await this.post("api/project/operate", packer, {
      type: "operate",
      id: this.newId(),
      operator: name,
      clip: scope.clip,
      character: scope.character,
      channels,
      start_s: scope.span?.[0] ?? null,
      end_s: scope.span?.[1] ?? null,
      parameters: { ...parameters },
    });
    const label = operators.known.find((o) => o.name === name)?.label ?? name;
    if (report) studio.toast("info", label, report);
  }

  async undo(): Promise<void> {
    if (!this.status?.undo) return;
    const done = this.until("undo");
    studio.connection.send({ type: "project_undo" });
    await done;
  }

  async redo(): Promise<void> {
    if (!this.status?.redo) return;
    const done = this.until("redo");
    studio.connection.send({ type: "project_redo" });
    await done;
  }

  // ---- files -------------------------------------------------------------------------------------------------------

  /** Do something that puts another project in the place of this one; ask first where that would surprise. */
  guard(what: string, go: (discard: boolean) => void): void {
    this.offered = true; // who begins or opens something has decided
    const worth = this.unsaved && (this.document.characters.length > 0 || this.document.clips.size > 0);
    if (worth) this.guarded = { what, go };
    else go(false);
  }

  create(name: string, character: string): void {
    this.guard("begin a new project", (discard) => studio.connection.send({ type: "project_new", name, character, discard }));
  }

  openFile(path: string): void {
    this.guard("open another project", (discard) => studio.connection.send({ type: "project_open", path, discard }));
  }

  /** Save where it was saved before, or under a path; asks for one where there is none yet. */
  save(path: string | null = null, force = false): Promise<void> {
    if (path === null && !this.status?.path) {
      this.dialog = "save";
      return Promise.resolve();
    }
    this.notSaved = null;
    return editor.enqueue(async () => {
      const done = this.until("save");
      studio.connection.send({ type: "project_save", path, force });
      await done;
    }, "The project was not saved");
  }

  recover(id: string): void {
    this.guard("recover another project", () => studio.connection.send({ type: "project_recover", id }));
  }

  discard(id: string): void {
    this.recoverable = this.recoverable.filter((r) => r.id !== id);
    studio.connection.send({ type: "project_discard", id });
  }

  browse(folder: string): void {
    studio.connection.send({ type: "project_browse", folder });
  }

  addCharacter(source: string): void {
    studio.connection.send({ type: "project_add_character", source });
  }

  removeCharacter(name: string): void {
    studio.connection.send({ type: "project_remove_character", name });
  }

  importClip(source: string, animation: number): void {
    studio.connection.send({ type: "project_import_clip", source, animation });
  }

  async download(format: string): Promise<void> {
    try {
      const who = new URLSearchParams({ character: editor.character?.name ?? "", timeline: editor.timeline?.name ?? "" });
      const blob = await studio.connection.file(`api/project/export/${format}?${who}`);
      save(blob, `${(this.status?.name || "project").replace(/[^\w.-]+/g, "_")}.${format}`);
    } catch (error) {
      studio.toast("error", `No ${format.toUpperCase()} file was written`, error instanceof Error ? error.message : String(error));
    }
  }
}

const fileName = (path: string) => path.replace(/^.*[\\/]/, "");

export const project = new Project();
