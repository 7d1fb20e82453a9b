// Undo for what the user sets by hand in the view.

interface Step {
  label: string;
  /** Steps of one key that follow each other quickly (a slider being dragged) are one step. */
  key: string;
  at: number;
  undo: () => void;
  redo: () => void;
}

const MERGE_MS = 900;

export class History {
  private past = $state.raw<Step[]>([]);
  private future = $state.raw<Step[]>([]);

  get undoLabel(): string | null {
    return this.past.at(-1)?.label ?? null;
  }

  get redoLabel(): string | null {
    return this.future.at(-1)?.label ?? null;
  }

  /** Note a change that was already made. */
  push(label: string, key: string, undo: () => void, redo: () => void): void {
    const last = this.past.at(-1);
    const at = performance.now();
    const merged = last && last.key === key && key !== "" && at - last.at < MERGE_MS;
    const step = { label, key, at, undo: merged ? last.undo : undo, redo };
    this.past = [...(merged ? this.past.slice(0, -1) : this.past), step].slice(-200);
    this.future = [];
  }

  /** What it was about is gone. */
  clear(): void {
    this.past = this.future = [];
  }

  undo(): string | null {
    const step = this.past.at(-1);
    if (!step) return null;
    this.past = this.past.slice(0, -1);
    this.future = [...this.future, step];
    step.undo();
    return step.label;
  }

  redo(): string | null {
    const step = this.future.at(-1);
    if (!step) return null;
    this.future = this.future.slice(0, -1);
    this.past = [...this.past, { ...step, key: "" }];
    step.redo();
    return step.label;
  }
}
