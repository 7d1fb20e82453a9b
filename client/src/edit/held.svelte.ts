// What is posed by hand and not keyed: shown over the animation until time moves. Each change of it is a step that undo takes
// back before any step of the document.

export type HeldValues = ReadonlyMap<string, readonly number[]>;

interface Step {
  readonly label: string;
  /** What was held before it or, of one that was undone, after it. */
  readonly values: HeldValues;
}

const NONE: HeldValues = new Map();

export class HeldPose {
  values = $state.raw<HeldValues>(NONE);
  /** The moment that it belongs to, in seconds of the timeline. */
  time = 0;
  private past = $state.raw<readonly Step[]>([]);
  private future = $state.raw<readonly Step[]>([]);
  /** What was held before the drag that goes on now. */
  private before: HeldValues | null = null;

  get undoLabel(): string | null {
    return this.past.at(-1)?.label ?? null;
  }

  get redoLabel(): string | null {
    return this.future.at(-1)?.label ?? null;
  }

  /** Hold further values; a drag makes one step when it is `done`. */
  hold(values: HeldValues, time: number, label: string, done: boolean): void {
    this.before ??= this.values;
    this.values = new Map([...this.values, ...values]);
    this.time = time;
    if (done) this.step(label);
  }

  /** Back to the animation, as a step of its own. */
  drop(): void {
    if (this.values.size === 0) return;
    this.before ??= this.values;
    this.values = NONE;
    this.step("Back to the animation");
  }

  private step(label: string): void {
    this.past = [...this.past, { label, values: this.before! }];
    this.future = [];
    this.before = null;
  }

  /** Put back what was held before a drag that is given up. */
  restore(values: HeldValues): void {
    this.values = values;
    this.before = null;
  }

  /** What is held stays, and its steps are none any more: the document has gone on. */
  settle(): void {
    if (this.past.length + this.future.length === 0) return;
    this.past = this.future = [];
  }

  /** Nothing is held. */
  forget(): void {
    if (this.values.size > 0) this.values = NONE;
    this.before = null;
    this.settle();
  }

  /** Take the last step back; false where there is none. */
  undo(): boolean {
    const last = this.past.at(-1);
    if (!last) return false;
    this.past = this.past.slice(0, -1);
    this.future = [...this.future, { label: last.label, values: this.values }];
    this.restore(last.values);
    return true;
  }

  redo(): boolean {
    const next = this.future.at(-1);
    if (!next) return false;
    this.future = this.future.slice(0, -1);
    this.past = [...this.past, { label: next.label, values: this.values }];
    this.restore(next.values);
    return true;
  }
}
