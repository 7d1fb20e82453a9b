// What the curve views know: what is shown of the clip, how, and what is being done with it.

import type { EditCurve, Editor, KeySelection } from "../contract";
import { hueOfLayer, ROW, type DopeScene } from "./dope-drawing";
import type { Drag } from "./drags";
import { readCurveColors, type CurveColors } from "./colors";
import { selectedTimes } from "./picking";
import { MARKERS, RULER, type RulerState } from "./ruler-drawing";
import { masksOf } from "./selection";
import { extent, type Shape } from "./shapes";
import { lineId, linesOf, rowsOf, type Line, type Row } from "./tree";
import { View, type ClipMap } from "./view";

export interface MenuItem {
  readonly label: string;
  readonly run?: () => void;
  readonly keys?: string;
  readonly checked?: boolean;
  readonly disabled?: boolean;
  readonly heading?: boolean;
}

export interface Menu {
  readonly x: number;
  readonly y: number;
  readonly items: readonly MenuItem[];
}

/** A key that the number fields show. */
export interface ActiveKey {
  readonly channel: string;
  readonly key: number;
  readonly component: number;
}

const NONE: ReadonlySet<string> = new Set();

export class CurveSession {
  readonly view = new View();
  mode = $state<"graph" | "dope">("graph");
  query = $state("");
  /** Rows that are folded against their habit. */
  toggled = $state.raw<ReadonlySet<string>>(NONE);
  /** Rows that were picked in the tree: the graph shows only these. */
  picked = $state.raw<ReadonlySet<string>>(NONE);
  solo = $state.raw<ReadonlySet<string>>(NONE);
  /** Single lines that are hidden; whole channels are in the editor's set. */
  hiddenLines = $state.raw<ReadonlySet<string>>(NONE);
  normalised = $state(false);
  ripple = $state(false);
  scroll = $state(0);
  active = $state.raw<ActiveKey | null>(null);
  menu = $state.raw<Menu | null>(null);
  readout = $state.raw<{ x: number; y: number; text: string } | null>(null);
  cursor = $state("default");
  drag = $state.raw<Drag | null>(null);
  hoveredRow = $state(-1);
  hoveredLine = "";
  pointer = { x: 0, y: 0, inside: false };
  colors = $state.raw<CurveColors>(null!);
  /** Called when something has to be drawn anew. */
  schedule: () => void = () => {};
  private memo: { channels: readonly EditCurve[]; toggled: ReadonlySet<string>; query: string; rows: readonly Row[] } | null = null;
  private lineMemo = new Map<string, { components: number; kind: string; lines: Line[] }>();
  /** How each line is normalised while something is dragged, so that the view stands still. */
  private frozen: ReadonlyMap<string, readonly [number, number]> | null = null;
  private fitted = false;
  private listed: readonly string[] | undefined;
  private listedQuery = "";

  constructor(readonly editor: Editor) {}

  rows = $derived.by((): readonly Row[] => {
    const { channels } = this.editor, { toggled, query, memo } = this;
    const same =
      memo && memo.toggled === toggled && memo.query === query && memo.channels.length === channels.length &&
      channels.every((c, n) => c.channel === memo.channels[n].channel && c.components === memo.channels[n].components);
    // while keys are dragged the curves change and the rows do not
    if (same) {
      memo.channels = channels;
      return memo.rows;
    }
    const rows = rowsOf(channels, toggled, query);
    this.memo = { channels, toggled, query, rows };
    return rows;
  });

  /** All listed curves by channel, as they are shown now. */
  curves(): Map<string, EditCurve> {
    return new Map(this.editor.channels.map((c) => [c.channel.key, c]));
  }

  readTheme(element: Element): void {
    this.colors = readCurveColors(element);
  }

  get rate(): number {
    return this.editor.timeline?.rate ?? this.editor.clip?.rate ?? 25;
  }

  /** How the active clip lies on the timeline: its placement on the active layer. */
  clipMap(): ClipMap {
    const { layer, clip } = this.editor;
    const placement = clip && layer?.placements.find((p) => p.animation === clip.name && !p.timeWarp);
    if (!placement || !(placement.speed > 0)) return { speed: 1, shift: 0 };
    let from = placement.inTime;
    if (from === null) {
      from = Infinity;
      for (const curve of clip.curves.values()) from = Math.min(from, curve.times[0]);
      if (!isFinite(from)) from = 0;
    }
    return { speed: placement.speed, shift: from - placement.speed * placement.start };
  }

  /** Bring the view's own numbers up to date with the document, before drawing. */
  prepare(): void {
    if (!this.drag) this.view.clip = this.clipMap();
    this.view.top = RULER + ((this.editor.timeline?.markers.length ?? 0) > 0 ? MARKERS : 0);
    if (this.view.width < 40 || this.editor.channels.length === 0 || this.drag) return;
    const listed = this.rows[0]?.channels;
    if (!this.fitted) {
      this.fitted = true;
      this.frameAll();
    } else if (listed !== this.listed && this.query === this.listedQuery) this.lookAround();
    this.listed = listed;
    this.listedQuery = this.query;
  }

  /** Other channels than before: their values come into view where they are far outside or all in one line. */
  private lookAround(): void {
    const { view } = this;
    let low = Infinity, high = -Infinity;
    const shapes = this.shapes();
    for (const shape of shapes) {
      const own = extent(shape);
      if (own) [low, high] = [Math.min(low, own[0]), Math.max(high, own[1])];
    }
    const height = (high - low) * view.perUnit;
    if (low > view.toValue(view.top) || high < view.toValue(view.height) || height < 0.15 * view.plot || height > 2 * view.plot) this.fitLines(shapes);
  }

  get clipTime(): number {
    return this.view.clip.speed * this.editor.time + this.view.clip.shift;
  }

  ruler(): RulerState {
    const { editor, view, colors } = this;
    const { timeline, layer, clip } = editor;
    const ends = clip && this.clipEnds();
    return {
      rate: this.rate,
      start: timeline?.start ?? 0,
      end: timeline?.end ?? 0,
      time: editor.time,
      markers: timeline?.markers ?? [],
      span: editor.span,
      clip: ends && {
        from: (ends[0] - view.clip.shift) / view.clip.speed,
        to: (ends[1] - view.clip.shift) / view.clip.speed,
        hue: hueOfLayer(colors, layer?.name ?? clip.name),
      },
    };
  }

  /** First and last key of the clip. */
  clipEnds(): [number, number] | null {
    let from = Infinity, to = -Infinity;
    for (const { times } of this.editor.clip?.curves.values() ?? []) {
      from = Math.min(from, times[0]);
      to = Math.max(to, times[times.length - 1]);
    }
    return from <= to ? [from, to] : null;
  }

  // ---- what is seen --------------------------------------------------------------------------------------------------

  private linesOf(curve: EditCurve): Line[] {
    const { key } = curve.channel;
    let known = this.lineMemo.get(key);
    if (!known || known.components !== curve.components || known.kind !== curve.kind)
      this.lineMemo.set(key, (known = { components: curve.components, kind: curve.kind, lines: linesOf(curve) }));
    return known.lines;
  }

  /** Lines that the graph shows: found, neither hidden nor outvoted by others that are solo or picked. */
  shapes(curves: ReadonlyMap<string, EditCurve> = this.curves()): Shape[] {
    const { hidden } = this.editor, { solo, hiddenLines } = this;
    const wanted = this.pickedLines(), listed = this.rows[0]?.channels ?? [];
    // what is solo in another clip says nothing here
    const alone = solo.size > 0 && listed.some((key) => solo.has(key));
    const out: Shape[] = [];
    for (const key of listed) {
      const curve = curves.get(key);
      if (!curve || hidden.has(key) || (alone && !solo.has(key))) continue;
      for (const line of this.linesOf(curve)) {
        if (hiddenLines.has(line.id) || (wanted && !wanted.has(line.id))) continue;
        const [factor, offset] = this.normalised ? this.norm(curve, line) : [line.unit, 0];
        out.push({ line, curve, factor, offset });
      }
    }
    return out;
  }

  /** Factor and offset that bring a line to -1..1. */
  private norm(curve: EditCurve, line: Line): readonly [number, number] {
    const known = this.frozen?.get(line.id);
    if (known) return known;
    const { values, components } = curve;
    let low = Infinity, high = -Infinity;
    for (let n = line.component; n < values.length; n += components) {
      low = Math.min(low, values[n]);
      high = Math.max(high, values[n]);
    }
    return high - low < 1e-9 ? [1, -low] : [2 / (high - low), -(high + low) / (high - low)];
  }

  /** Lines of the rows picked in the tree; null where none is. */
  private pickedLines(): ReadonlySet<string> | null {
    if (this.picked.size === 0) return null;
    const out = new Set<string>();
    for (const row of this.rows) {
      if (!this.picked.has(row.id) || row.kind === "all") continue;
      if (row.kind === "component") out.add(lineId(row.channels[0], row.component));
      else for (const key of row.channels) for (let c = 0; c < 4; c++) out.add(lineId(key, c));
    }
    return out.size > 0 ? out : null;
  }

  dope(curves: ReadonlyMap<string, EditCurve> = this.curves()): DopeScene {
    const { editor } = this;
    const ends = this.clipEnds() ?? [0, 0];
    return {
      view: this.view,
      colors: this.colors,
      rows: this.rows,
      scroll: this.scroll,
      curves,
      selection: this.selection,
      locked: editor.locked,
      muted: editor.muted,
      hoveredRow: this.hoveredRow,
      tint: hueOfLayer(this.colors, editor.layer?.name ?? editor.clip?.name ?? ""),
      clipFrom: ends[0],
      clipTo: ends[1],
    };
  }

  /** Selected keys; while they are dragged, where they are in the curves that are shown. */
  get selection(): KeySelection {
    return this.drag?.selection ?? this.editor.selection;
  }

  get maxScroll(): number {
    return Math.max(0, this.rows.length * ROW - this.view.plot);
  }

  // ---- framing -------------------------------------------------------------------------------------------------------

  frameAll(): void {
    const { view, editor } = this;
    const ends = this.clipEnds(), timeline = editor.timeline;
    const times = ends ? ends.map((t) => (t - view.clip.shift) / view.clip.speed) : [];
    if (timeline) times.push(timeline.start, timeline.end);
    if (times.length > 0) view.fitTime(Math.min(...times), Math.max(...times));
    this.fitLines(this.shapes());
    this.scroll = 0;
    this.schedule();
  }

  frameSelected(): void {
    const { view } = this;
    const curves = this.curves(), ends = selectedTimes(curves, this.selection);
    if (!ends) return this.frameAll();
    const [from, to] = ends.map((t) => (t - view.clip.shift) / view.clip.speed);
    view.fitTime(from, to, 8 / this.rate);
    const chosen = this.shapes(curves).filter(({ line }) => {
      const indices = this.selection.get(line.channel), mask = indices && masksOf(indices);
      return indices && (!mask || mask.some((m) => (m >> line.component) & 1));
    });
    this.fitLines(chosen, ends[0], ends[1]);
    this.schedule();
  }

  private fitLines(shapes: readonly Shape[], from?: number, to?: number): void {
    let low = Infinity, high = -Infinity;
    for (const shape of shapes) {
      const own = extent(shape, from, to);
      if (!own) continue;
      low = Math.min(low, own[0]);
      high = Math.max(high, own[1]);
    }
    if (low > high) return;
    // a flat line gets room to see a change in, by its size
    if (high - low < 1e-9) this.view.fitValue(low - Math.max(0.5, Math.abs(low) * 0.2), high + Math.max(0.5, Math.abs(low) * 0.2));
    else this.view.fitValue(low, high);
  }

  // ---- dragging ------------------------------------------------------------------------------------------------------

  /** False, and said why, where keys cannot be changed. */
  begin(drag: Drag): boolean {
    this.menu = null;
    const { layer } = this.editor;
    if (drag.base && layer?.locked) {
      this.editor.toast("info", "This layer is locked", `Unlock “${layer.name}” in the layers panel to change its keys.`);
      return false;
    }
    this.freeze();
    this.drag = drag;
    this.schedule();
    return true;
  }

  private freeze(): void {
    if (!this.normalised) return;
    const known = new Map<string, readonly [number, number]>();
    for (const { line, factor, offset } of this.shapes()) known.set(line.id, [factor, offset]);
    this.frozen = known;
  }

  finish(keep: boolean): void {
    const { drag } = this;
    if (!drag) return;
    this.drag = null;
    drag.end(keep);
    this.frozen = null;
    this.readout = null;
    this.schedule();
  }
}
