// An editor without a server: a document, what is previewed, and undo.

import type { Actor } from "../src/view/actor";
import type { Changes, EditClip, EditCurve, EditDocument, EditLayer, Editor, EditTimeline, KeySelection } from "../src/edit/contract";
import { apply } from "../src/edit/document";

export class FakeEditor implements Editor {
  document = $state.raw<EditDocument>(null!);
  shown = $state.raw<EditDocument>(null!);
  selection = $state.raw<KeySelection>(new Map());
  hidden = $state.raw<ReadonlySet<string>>(new Set());
  muted = $state.raw<ReadonlySet<string>>(new Set());
  locked = $state.raw<ReadonlySet<string>>(new Set());
  snap = $state(true);
  span = $state.raw<readonly [number, number] | null>(null);
  time = $state(0);
  autoKey = false;
  actor: Actor | null = null;
  selectedJoints: readonly number[] = [];
  posed: ReadonlyMap<string, readonly number[]> = new Map();
  /** Labels of the steps that were made, and documents from before each. */
  labels: string[] = [];
  private past: EditDocument[] = [];

  constructor(document: EditDocument) {
    this.document = this.shown = document;
  }

  timeline = $derived.by((): EditTimeline | null => [...this.shown.timelines.values()][0] ?? null);
  layer = $derived.by((): EditLayer | null => this.timeline?.layers[0] ?? null);
  clip = $derived.by((): EditClip | null => [...this.shown.clips.values()][0] ?? null);
  channels = $derived.by((): readonly EditCurve[] => [...(this.clip?.curves.values() ?? [])]);

  seek(time: number): void {
    this.time = time;
  }

  preview(changes: Changes | null): void {
    this.shown = changes ? apply(this.document, changes) : this.document;
  }

  commit(label: string, changes: Changes): void {
    const next = apply(this.document, changes);
    if (next !== this.document) {
      this.past.push(this.document);
      this.labels.push(label);
    }
    this.document = this.shown = next;
  }

  undo(): void {
    const before = this.past.pop();
    if (!before) return;
    this.labels.pop();
    this.document = this.shown = before;
  }

  redo(): void {}
  pose(): void {}
  dropPosed(): void {}
  insertKeys(): void {}
  toast(): void {}
  operate(): Promise<void> {
    return Promise.resolve();
  }
}
