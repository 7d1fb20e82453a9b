// What can be dragged: keys (moved or scaled), handles, boxes, the view, the playhead, the range and markers. A drag shows
// its result with `preview` while it lasts and makes one step of undo when it ends.

import type { EditCurve, KeySelection } from "../contract";
import { compact, duplicateKeys, ripple, setHandle, STILL, transformKeys, type Keyed, type Transform } from "../keys";
import { affected, type Ranges } from "./graph-drawing";
import { keysInBox, rowKeysInBox } from "./picking";
import { combined, masksOf, withMasks, type How } from "./selection";
import type { CurveSession } from "./session.svelte";
import { shownValue, valueOf, type Shape } from "./shapes";
import { lineId } from "./tree";
import { ordered, valueStep, type Box } from "./view";

export interface Modifiers {
  readonly shift: boolean;
  readonly ctrl: boolean;
  readonly alt: boolean;
}

export interface Drag {
  readonly cursor: string;
  /** Goes on without a pressed button until it is confirmed. */
  readonly modal?: boolean;
  /** Selected keys in the curves that are shown now. */
  readonly selection?: KeySelection;
  /** Channels that change, with the keys whose spans do, and their curves from before. */
  readonly dragged?: ReadonlyMap<string, Ranges>;
  readonly base?: ReadonlyMap<string, EditCurve>;
  /** The clip's times between which all dragged curves are drawn anew, once keys have passed others. */
  readonly interval?: readonly [number, number] | null;
  readonly box?: Box | null;
  readonly removing?: boolean;
  /** Only along time (x) or value (y). */
  lock?: "x" | "y" | null;
  move(x: number, y: number, modifiers: Modifiers): void;
  end(keep: boolean): void;
}

interface Held {
  readonly curve: EditCurve;
  readonly indices: Uint32Array;
  readonly mask: Uint8Array | null;
}

/** Selected keys of channels that can be edited. */
export function heldKeys(session: CurveSession): Map<string, Held> {
  const curves = session.curves(), held = new Map<string, Held>();
  for (const [key, indices] of session.editor.selection) {
    const curve = curves.get(key);
    if (!curve || session.editor.locked.has(key)) continue;
    const own = indices[indices.length - 1] < curve.times.length ? indices : indices.filter((k) => k < curve.times.length);
    if (own.length > 0) held.set(key, { curve, indices: own, mask: own === indices ? masksOf(indices) : null });
  }
  return held;
}

const same = (a: Uint32Array, b: Uint32Array) => a === b || (a.length === b.length && a.every((k, n) => k === b[n]));

/** Keys that a transform of time and value is applied to again and again, from where they were. */
abstract class KeyDrag implements Drag {
  abstract readonly cursor: string;
  lock: "x" | "y" | null = null;
  dragged: ReadonlyMap<string, Ranges>;
  selection: KeySelection;
  readonly base: ReadonlyMap<string, EditCurve>;
  protected readonly held: Map<string, Held>;
  private results = new Map<string, Keyed>();
  private readonly spare = new Map<string, EditCurve>();
  protected readonly shapes = new Map<string, Shape>();
  private moved = false;
  interval: [number, number] | null = null;

  constructor(
    protected readonly session: CurveSession,
    readonly modal: boolean,
    private readonly label: string,
  ) {
    this.held = heldKeys(session);
    this.base = new Map([...this.held].map(([key, { curve }]) => [key, curve]));
    this.dragged = new Map([...this.held].map(([key, { curve, indices }]) => [key, affected(curve, indices)]));
    this.selection = session.editor.selection;
    for (const shape of session.shapes(session.curves())) this.shapes.set(shape.line.id, shape);
  }

  abstract move(x: number, y: number, modifiers: Modifiers): void;

  /** Shift of values for each component, where lines have scales of their own. */
  protected shiftsOf(key: string, width: number, shift: (shape: Shape | undefined) => number): number[] {
    return Array.from({ length: width }, (_, c) => shift(this.shapes.get(lineId(key, c))));
  }

  protected show(transformOf: (key: string, held: Held) => Transform, of: (held: Held, transform: Transform, spare: EditCurve | null) => Keyed = defaultTransform): void {
    const { session } = this;
    const changes = new Map<string, EditCurve>(), selection = new Map(session.editor.selection);
    let passing = false;
    for (const [key, held] of this.held) {
      // the picture before last is not shown any more, so its memory serves again
      const done = of(held, transformOf(key, held), this.spare.get(key) ?? null);
      const last = this.results.get(key)?.curve;
      if (last && last !== held.curve) this.spare.set(key, last);
      this.results.set(key, done);
      if (done.curve !== held.curve) changes.set(key, done.curve);
      const stays = same(done.indices, held.indices);
      selection.set(key, stays ? held.indices : withMasks(done.indices, done.indices.length === held.indices.length ? held.mask : null));
      passing ||= !stays || done.curve.times.length !== held.curve.times.length;
    }
    if (passing || this.interval) this.interval = this.swept();
    this.moved = changes.size > 0;
    this.selection = selection;
    session.editor.preview(this.moved ? { curves: new Map([[session.editor.clip!.name, changes]]) } : null);
  }

  /** From the first to the last time at which any curve is another than before, now or in an earlier picture. */
  private swept(): [number, number] {
    let [from, to] = this.interval ?? [Infinity, -Infinity];
    for (const [key, { curve, indices }] of this.held) {
      const done = this.results.get(key)!;
      for (const [{ times }, own] of [[curve, indices], [done.curve, done.indices]] as const) {
        from = Math.min(from, times[Math.max(0, own[0] - 2)]);
        to = Math.max(to, times[Math.min(times.length - 1, own[own.length - 1] + 2)]);
      }
    }
    return [from, to];
  }

  end(keep: boolean): void {
    const { editor } = this.session;
    if (!keep || !this.moved) {
      editor.preview(null);
      return;
    }
    const changes = new Map<string, EditCurve>();
    for (const [key, { curve }] of this.results) {
      const base = this.base.get(key)!;
      if (curve !== base) changes.set(key, compact(curve, base));
    }
    const { selection } = this;
    editor.commit(this.label, { curves: new Map([[editor.clip!.name, changes]]) });
    editor.selection = selection;
    this.session.active = followed(this.session.active, this.results, this.held);
  }
}

const defaultTransform = ({ curve, indices, mask }: Held, transform: Transform, spare: EditCurve | null) => transformKeys(curve, indices, transform, mask, spare);

/** The active key, after its curve's keys moved. */
function followed(active: CurveSession["active"], results: ReadonlyMap<string, Keyed>, held: ReadonlyMap<string, Held>): CurveSession["active"] {
  if (!active) return null;
  const result = results.get(active.channel), at = held.get(active.channel)?.indices.indexOf(active.key) ?? -1;
  if (!result || at < 0) return active;
  return at < result.indices.length ? { ...active, key: result.indices[at] } : null;
}

export class MoveDrag extends KeyDrag {
  readonly cursor = "grabbing";
  private readonly rippling: boolean;
  private readonly earliest: number;

  constructor(
    session: CurveSession,
    private readonly fromX: number,
    private readonly fromY: number,
    /** Clip time and shown value of the key that was grabbed: it lands on frames and grid lines. */
    private readonly anchor: { time: number; value: number; factor: number } | null,
    { modal = false, values = true, duplicate = false }: { modal?: boolean; values?: boolean; duplicate?: boolean } = {},
  ) {
    super(session, modal, duplicate ? "Duplicate keys" : "Move keys");
    this.values = values;
    this.duplicate = duplicate;
    this.rippling = session.ripple && !duplicate;
    let earliest = -Infinity;
    if (this.rippling) {
      this.dragged = new Map([...this.held].map(([key, { curve, indices }]) => [key, affected(curve, ripple(curve, indices))]));
      for (const { curve, indices } of this.held.values())
        if (indices[0] > 0) earliest = Math.max(earliest, curve.times[indices[0] - 1] - curve.times[indices[0]] + 1 / session.rate);
    }
    this.earliest = earliest;
  }

  private readonly values: boolean;
  private readonly duplicate: boolean;

  move(x: number, y: number, { shift, ctrl, alt }: Modifiers): void {
    const { session, anchor } = this;
    const { view, editor, rate } = session;
    let dx = x - this.fromX, dy = y - this.fromY;
    const lock = this.lock ?? (shift && this.values ? (Math.abs(dx) >= Math.abs(dy) ? "x" : "y") : null);
    if (lock === "y") dx = 0;
    if (lock === "x" || !this.values) dy = 0;
    let seconds = dx / view.perSecond, shown = -dy / view.perUnit;
    const at = anchor ? (anchor.time - view.clip.shift) / view.clip.speed : 0;
    if (editor.snap !== alt && dx !== 0) seconds = Math.round((at + seconds) * rate) / rate - at;
    if (ctrl && dy !== 0 && anchor) {
      const { step } = valueStep(view.perUnit);
      shown = Math.round((anchor.value + shown) / step) * step - anchor.value;
    }
    let clipSeconds = seconds * view.clip.speed;
    if (clipSeconds < this.earliest) clipSeconds = Math.min(0, this.earliest);
    this.show(
      (key, { curve }) => ({
        ...STILL,
        shiftTime: clipSeconds,
        shiftValue: shown === 0 ? 0 : this.shiftsOf(key, curve.components, (shape) => (shape ? shown / shape.factor : 0)),
      }),
      this.duplicate
        ? ({ curve, indices }, { shiftTime }) => (shiftTime === 0 ? { curve, indices } : duplicateKeys(curve, indices, shiftTime))
        : this.rippling
          ? ({ curve, indices, mask }, transform) => {
              const later = transformKeys(curve, ripple(curve, indices), { ...STILL, shiftTime: transform.shiftTime });
              return transformKeys(later.curve, indices, { ...transform, shiftTime: 0 }, mask);
            }
          : undefined,
    );
    const frames = seconds * rate, parts: string[] = [];
    if (anchor && lock !== "y") parts.push(`frame ${+((at + seconds) * rate).toFixed(2)} (${signed(frames, 2)})`);
    else if (lock !== "y") parts.push(`${signed(frames, 2)} frames`);
    if (this.values && lock !== "x") parts.push(anchor ? `${(anchor.value + shown).toFixed(3)} (${signed(shown, 3)})` : signed(shown, 3));
    session.readout = { x, y, text: parts.join("   ") };
  }
}

export interface Pivot {
  /** Canvas pixels. */
  readonly x: number;
  readonly y: number;
}

export class ScaleDrag extends KeyDrag {
  constructor(
    session: CurveSession,
    private readonly fromX: number,
    private readonly fromY: number,
    private readonly pivot: Pivot,
    private readonly axes: { readonly time: boolean; readonly value: boolean },
    modal: boolean,
    readonly cursor: string,
    /** About this place instead while Alt is held. */
    private readonly middle: Pivot | null = null,
  ) {
    super(session, modal, "Scale keys");
  }

  move(x: number, y: number, { alt, shift }: Modifiers): void {
    const { session, axes } = this;
    const { view } = session;
    const pivot = alt && this.middle ? this.middle : this.pivot;
    let scaleTime = 1, scaleValue = 1;
    if (this.modal) {
      // by the distance from the pivot, so that keys scale in both directions alike
      const before = Math.hypot(this.fromX - pivot.x, axes.value ? this.fromY - pivot.y : 0) || 1;
      const along = (x - pivot.x) * (this.fromX - pivot.x) + (axes.value ? (y - pivot.y) * (this.fromY - pivot.y) : 0);
      const factor = along / (before * before);
      scaleTime = axes.time && this.lock !== "y" ? factor : 1;
      scaleValue = axes.value && this.lock !== "x" ? factor : 1;
    } else {
      if (axes.time) scaleTime = ratio(x - pivot.x, this.fromX - pivot.x);
      if (axes.value) scaleValue = ratio(y - pivot.y, this.fromY - pivot.y);
      if (axes.time && axes.value && shift) scaleTime = scaleValue = Math.max(scaleTime, scaleValue);
    }
    const time = view.clipTime(pivot.x), shown = view.toValue(pivot.y);
    this.show((key, { curve }) => ({
      scaleTime,
      shiftTime: (1 - scaleTime) * time,
      scaleValue,
      shiftValue: scaleValue === 1 ? 0 : this.shiftsOf(key, curve.components, (shape) => (shape ? (1 - scaleValue) * valueOf(shape, shown) : 0)),
    }));
    const parts: string[] = [];
    if (axes.time) parts.push(`time × ${scaleTime.toFixed(3)}`);
    if (axes.value) parts.push(`value × ${scaleValue.toFixed(3)}`);
    session.readout = { x, y, text: parts.join("   ") };
  }
}

const ratio = (a: number, b: number) => (Math.abs(b) < 1 ? 1 : a / b);
const signed = (n: number, digits: number) => `${n >= 0 ? "+" : "−"}${Math.abs(+n.toFixed(digits))}`;

export class HandleDrag implements Drag {
  readonly cursor = "grabbing";
  lock: "x" | "y" | null = null;
  readonly base: ReadonlyMap<string, EditCurve>;
  readonly dragged: ReadonlyMap<string, Ranges>;
  readonly selection: KeySelection;
  private result: EditCurve;

  constructor(
    private readonly session: CurveSession,
    private readonly shape: Shape,
    private readonly key: number,
    private readonly side: 0 | 1,
  ) {
    const { curve, line } = shape;
    this.result = curve;
    this.base = new Map([[line.channel, curve]]);
    this.dragged = new Map([[line.channel, affected(curve, Uint32Array.of(key))]]);
    this.selection = session.editor.selection;
  }

  move(x: number, y: number, { shift, ctrl }: Modifiers): void {
    const { session, shape, key, side } = this;
    const { curve, line } = shape;
    const { view } = session;
    const value = curve.values[key * curve.components + line.component];
    const kx = view.clipX(curve.times[key]), ky = view.toY(shownValue(shape, value));
    const lock = this.lock ?? (shift ? (Math.abs(x - kx) >= Math.abs(y - ky) ? "x" : "y") : null);
    let shown = lock === "x" ? shownValue(shape, value) : view.toValue(y);
    if (ctrl) {
      const { step } = valueStep(view.perUnit);
      shown = Math.round(shown / step) * step;
    }
    const seconds = lock === "y" ? 0 : view.clipTime(x) - curve.times[key];
    this.result = setHandle(curve, key, line.component, side, seconds, valueOf(shape, shown) - value);
    session.editor.preview({ curves: new Map([[session.editor.clip!.name, new Map([[line.channel, this.result]])]]) });
    const slope = seconds !== 0 ? (shown - shownValue(shape, value)) / (seconds / view.clip.speed) : Infinity;
    session.readout = { x, y, text: `${signed((seconds / view.clip.speed) * session.rate, 2)} frames   ${signed(shown - shownValue(shape, value), 3)}   slope ${isFinite(slope) ? slope.toFixed(2) : "∞"} /s` };
  }

  end(keep: boolean): void {
    const { editor } = this.session;
    const { line, curve } = this.shape;
    if (keep && this.result !== curve) editor.commit("Move a handle", { curves: new Map([[editor.clip!.name, new Map([[line.channel, this.result]])]]) });
    else editor.preview(null);
  }
}

export class BoxDrag implements Drag {
  readonly cursor = "crosshair";
  box: Box | null = null;
  readonly removing: boolean;

  constructor(
    private readonly session: CurveSession,
    private readonly fromX: number,
    private readonly fromY: number,
    private readonly how: How,
    /** A click that did not become a box. */
    private readonly click: () => void,
  ) {
    this.removing = how === "remove";
  }

  move(x: number, y: number): void {
    if (!this.box && Math.hypot(x - this.fromX, y - this.fromY) < 4) return;
    this.box = ordered(this.fromX, this.fromY, x, y);
  }

  end(keep: boolean): void {
    const { session, box } = this;
    if (!keep) return;
    if (!box) return this.click();
    const hits =
      session.mode === "graph" ? keysInBox(session.view, session.shapes(), session.editor.locked, box) : rowKeysInBox(session.dope(), box);
    session.editor.selection = combined(session.editor.selection, hits, this.how);
  }
}

export class PanDrag implements Drag {
  readonly cursor = "grabbing";
  constructor(
    private readonly session: CurveSession,
    private x: number,
    private y: number,
    private readonly zoom: boolean,
    private readonly scrollTo: (scroll: number) => void,
  ) {}

  move(x: number, y: number): void {
    const { view, mode, scroll } = this.session;
    const dx = x - this.x, dy = y - this.y;
    if (this.zoom) {
      view.zoomTime(Math.exp(dx / 160), view.width / 2);
      if (mode === "graph") view.zoomValue(Math.exp(-dy / 160), view.top + view.plot / 2);
    } else {
      view.pan(dx, mode === "graph" ? dy : 0);
      if (mode === "dope") this.scrollTo(scroll - dy);
    }
    this.x = x;
    this.y = y;
  }

  end(): void {}
}

/** Selected time along the ruler; a press that goes nowhere selects none. */
export class SpanDrag implements Drag {
  readonly cursor = "ew-resize";
  private readonly before: readonly [number, number] | null;
  private readonly from: number;

  constructor(
    private readonly session: CurveSession,
    private readonly pressed: number,
  ) {
    this.before = session.editor.span;
    this.from = this.timeAt(pressed, false);
  }

  private timeAt(x: number, alt: boolean): number {
    const { view, editor, rate } = this.session, time = view.toTime(x);
    return editor.snap !== alt ? Math.round(time * rate) / rate : time;
  }

  move(x: number, y: number, { alt }: Modifiers): void {
    const { session, from } = this, to = this.timeAt(x, alt);
    session.editor.span = Math.abs(x - this.pressed) < 4 || to === from ? null : [Math.min(from, to), Math.max(from, to)];
    const frame = (time: number) => String(+(time * session.rate).toFixed(2));
    session.readout = session.editor.span && { x, y: y + 18, text: `frames ${session.editor.span.map(frame).join(" to ")}` };
  }

  end(keep: boolean): void {
    this.session.readout = null;
    if (!keep) this.session.editor.span = this.before;
  }
}

/** The playhead, an end of the range or a marker along the ruler. */
export class TimeDrag implements Drag {
  readonly cursor = "ew-resize";
  private time = NaN;
  constructor(
    private readonly session: CurveSession,
    private readonly what: "time" | "start" | "end" | number,
  ) {}

  move(x: number, y: number, { alt }: Modifiers): void {
    const { session, what } = this;
    const { view, editor, rate } = session;
    let time = view.toTime(x);
    if (editor.snap !== alt) time = Math.round(time * rate) / rate;
    this.time = time;
    if (what === "time") {
      editor.seek(time);
      return;
    }
    session.readout = { x, y: y + 18, text: `frame ${+(time * rate).toFixed(2)}` };
    editor.preview({ timelines: this.changed() });
  }

  private changed() {
    const { editor } = this.session;
    const timeline = editor.document.timelines.get(editor.timeline!.name)!;
    const { what, time } = this, frame = 1 / this.session.rate;
    if (what === "start") return new Map([[timeline.name, { ...timeline, start: Math.min(time, timeline.end - frame) }]]);
    if (what === "end") return new Map([[timeline.name, { ...timeline, end: Math.max(time, timeline.start + frame) }]]);
    const markers = timeline.markers.map((m, n) => (n === what ? { ...m, time } : m));
    return new Map([[timeline.name, { ...timeline, markers }]]);
  }

  end(keep: boolean): void {
    const { editor } = this.session;
    if (this.what === "time" || !editor.timeline) return;
    const labels = { start: "Move the start", end: "Move the end" } as const;
    if (keep && this.time === this.time) editor.commit(typeof this.what === "number" ? "Move a marker" : labels[this.what as "start" | "end"], { timelines: this.changed() });
    else editor.preview(null);
  }
}
