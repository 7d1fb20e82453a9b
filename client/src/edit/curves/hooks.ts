// What tests ask of the curve views: where things are on the page, and what was drawn. Nothing here changes what is shown.

import { handleOf, counts, shownValue, type Shape } from "./shapes";
import { rowTop, ROW } from "./dope-drawing";
import { countKeys, masksOf } from "./selection";
import type { CurveSession } from "./session.svelte";

export interface FrameLog {
  /** Milliseconds of script of each drawn frame: what is dragged is computed, shown and drawn. */
  script: number[];
}

export function installCurveHooks(session: CurveSession, canvas: HTMLCanvasElement, log: FrameLog): void {
  const { view } = session;
  const onPage = (x: number, y: number): [number, number] => {
    const box = canvas.getBoundingClientRect();
    return [box.left + x, box.top + y];
  };
  const shapeOf = (channel: string, component: number): Shape => {
    const found = session.shapes().find((s) => s.line.channel === channel && s.line.component === component);
    if (!found) throw new Error(`no line ${channel} ${component}; there are ${session.shapes().map((s) => s.line.label).join(", ")}`);
    return found;
  };
  const curves = {
    state: () => ({
      mode: session.mode,
      rows: session.rows.map((r) => ({ id: r.id, kind: r.kind, label: r.label, open: r.open })),
      lines: session.shapes().map((s) => ({ channel: s.line.channel, component: s.line.component, label: s.line.label })),
      selection: [...session.selection].map(([channel, indices]) => ({ channel, keys: [...indices], masks: masksOf(indices) && [...masksOf(indices)!] })),
      selected: countKeys(session.selection),
      active: session.active,
      readout: session.readout?.text ?? null,
      menu: session.menu?.items.map((i) => i.label) ?? null,
      dragging: session.drag !== null,
      view: { left: view.left, perSecond: view.perSecond, middle: view.middle, perUnit: view.perUnit, top: view.top },
    }),
    /** Where a key of a line is on the page. */
    key: (channel: string, key: number, component = 0): [number, number] => {
      const shape = shapeOf(channel, component), { curve } = shape;
      return onPage(view.clipX(curve.times[key]), view.toY(shownValue(shape, curve.values[key * curve.components + component])));
    },
    handle: (channel: string, key: number, side: 0 | 1, component = 0): [number, number] | null => {
      const shape = shapeOf(channel, component), { curve } = shape, reach = handleOf(shape, key, side);
      const value = curve.values[key * curve.components + component];
      return reach && onPage(view.clipX(curve.times[key] + reach[0]), view.toY(shownValue(shape, value + reach[1])));
    },
    /** Where a time of the clip and a shown value are on the page. */
    place: (time: number, value: number): [number, number] => onPage(view.clipX(time), view.toY(value)),
    /** Where a time is on a row of the dope sheet. */
    row: (id: string, time: number): [number, number] => {
      const at = session.rows.findIndex((r) => r.id === id);
      if (at < 0) throw new Error(`no row ${id}`);
      return onPage(view.clipX(time), rowTop(view, session.scroll, at) + ROW / 2);
    },
    /** Where a time of the timeline is on the ruler. */
    ruler: (time: number): [number, number] => onPage(view.toX(time), 10),
    curve: (channel: string) => {
      const curve = session.curves().get(channel);
      if (!curve) return null;
      const list = (array: ArrayLike<number> | null) => array && Array.from(array);
      return {
        times: list(curve.times), values: list(curve.values), modes: list(curve.modes), types: list(curve.types),
        inHandles: list(curve.inHandles), outHandles: list(curve.outHandles), before: curve.before, after: curve.after,
      };
    },
    counts: () => ({ ...counts }),
    script: () => [...log.script],
    resetScript: () => void (log.script.length = 0),
    frame: (what: "all" | "selected") => (what === "all" ? session.frameAll() : session.frameSelected()),
    session: () => session,
  };
  const page = window as unknown as { keypose?: { test?: Record<string, unknown> } };
  page.keypose ??= {};
  page.keypose.test ??= {};
  page.keypose.test.curves = curves;
}
