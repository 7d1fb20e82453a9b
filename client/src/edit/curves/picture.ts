// The pictures of both views: what stands still is drawn once, into a backdrop, and only what moves with every frame.

import { prepare } from "../../play/colors";
import { drawKeys, drawRows } from "./dope-drawing";
import { drawBase, drawBox, drawGrid, drawLines, drawMoved, drawSelected, drawTransformBox, drawValues, type GraphScene } from "./graph-drawing";
import { gripsOf, transformBox } from "./grips";
import { drawFrames, drawPlayhead, drawRuler, type RulerState } from "./ruler-drawing";
import type { CurveSession } from "./session.svelte";
import { counts, lineValue, shownValue } from "./shapes";
import { isAngle } from "./tree";

export class Picture {
  private readonly backdrop = document.createElement("canvas");
  /** Dragged curves as they were, without what keys passed. */
  private readonly before = document.createElement("canvas");
  /** What the backdrop was made of. */
  private drawn: readonly unknown[] = [];

  constructor(
    private readonly session: CurveSession,
    private readonly canvas: HTMLCanvasElement,
  ) {}

  draw(width: number, height: number): void {
    const { session } = this;
    session.view.width = width;
    session.view.height = height;
    session.prepare();
    if (!session.colors) session.readTheme(this.canvas);
    if (session.mode === "graph") this.drawGraph();
    else this.drawDope();
  }

  /** Draw what stands still once, until anything it depends on is another. */
  private still(facts: readonly unknown[], paint: (c: CanvasRenderingContext2D) => void): void {
    if (facts.length !== this.drawn.length || facts.some((f, n) => f !== this.drawn[n])) {
      this.drawn = facts;
      counts.backdrops++;
      const { width, height } = this.session.view;
      paint(prepare(this.backdrop, width, height));
    }
  }

  private drawGraph(): void {
    const { session, canvas } = this, { view, editor, colors, drag } = session;
    const ruler = session.ruler();
    const shapes = session.shapes();
    const degrees = !session.normalised && shapes.length > 0 && shapes.every((s) => isAngle(s.curve));
    const scene: GraphScene = { view, colors, shapes, selection: session.selection, locked: editor.locked, muted: editor.muted, hovered: session.hoveredLine };
    const dragged = drag?.dragged ?? null;
    // while keys are dragged the backdrop holds what stays, and their curves from before
    const resting = drag?.base ? shapes.map((s) => (drag.base!.has(s.line.channel) ? { ...s, curve: drag.base!.get(s.line.channel)! } : s)) : shapes;
    const interval = drag?.interval ?? null;
    const facts: unknown[] = ["graph", colors, degrees, dragged, interval !== null, ruler.rate, ruler.start, ruler.end, ruler.span, session.normalised, editor.locked, editor.muted, dragged ? null : editor.selection, ...view.state()];
    for (const shape of resting) facts.push(shape.curve, shape.line, shape.factor, shape.offset);
    this.still(facts, (c) => {
      c.fillStyle = colors.ground;
      c.fillRect(0, 0, view.width, view.height);
      drawFrames(c, view, colors, ruler);
      drawGrid(c, view, colors, degrees);
      drawLines(c, { ...scene, shapes: resting }, dragged, interval !== null);
      if (!dragged) drawSelected(c, scene);
      if (dragged && interval) drawBase(prepare(this.before, view.width, view.height), { ...scene, shapes: resting }, dragged);
    });
    const c = prepare(canvas, view.width, view.height);
    c.drawImage(this.backdrop, 0, 0, view.width, view.height);
    if (dragged && interval) {
      const x0 = view.clipX(interval[0]), x1 = view.clipX(interval[1]);
      this.before.getContext("2d")!.clearRect(x0, 0, x1 - x0, view.height);
      c.drawImage(this.before, 0, 0, view.width, view.height);
      c.save();
      c.beginPath();
      c.rect(x0, view.top, x1 - x0, view.plot);
      c.clip();
      drawMoved(c, scene, dragged, interval);
      c.restore();
    } else if (dragged) drawMoved(c, scene, dragged, null);
    if (dragged) drawSelected(c, scene);
    if (shapes.length <= 24) drawValues(c, scene, view.toX(editor.time), shapes.map((s) => shownValue(s, lineValue(s, session.clipTime))));
    const box = drag ? null : transformBox(session, shapes);
    if (box) drawTransformBox(c, box, colors, gripsOf(session, box));
    this.finish(c, ruler);
    if (shapes.length === 0) this.empty(c, session.rows[0]?.channels.length ? "Everything is hidden" : editor.clip ? "No curves yet: key a joint to make some" : "No clip is being edited");
  }

  private drawDope(): void {
    const { session, canvas } = this, { view, editor, colors, drag } = session;
    const ruler = session.ruler(), curves = session.curves(), scene = session.dope(curves);
    const moving = drag?.base;
    const touched = (row: { channels: readonly string[] }) => moving !== undefined && row.channels.some((key) => moving.has(key));
    const facts: unknown[] = ["dope", colors, scene.rows, scene.scroll, scene.hoveredRow, scene.clipFrom, scene.clipTo, scene.tint, ruler.rate, ruler.start, ruler.end, ruler.span, editor.locked, editor.muted, moving, moving ? null : scene.selection, ...view.state()];
    for (const curve of curves.values()) if (!moving?.has(curve.channel.key)) facts.push(curve);
    this.still(facts, (c) => {
      c.fillStyle = colors.ground;
      c.fillRect(0, 0, view.width, view.height);
      drawRows(c, scene);
      drawFrames(c, view, colors, ruler);
      drawKeys(c, scene, moving ? (row) => !touched(row) : null);
    });
    const c = prepare(canvas, view.width, view.height);
    c.drawImage(this.backdrop, 0, 0, view.width, view.height);
    if (moving) drawKeys(c, scene, touched);
    const box = drag ? null : transformBox(session, []);
    if (box) drawTransformBox(c, box, colors, gripsOf(session, box));
    this.finish(c, ruler);
    if ((scene.rows[0]?.channels.length ?? 0) === 0) this.empty(c, editor.clip ? "No keys yet" : "No clip is being edited");
  }

  private finish(c: CanvasRenderingContext2D, ruler: RulerState): void {
    const { view, drag, colors } = this.session;
    if (drag?.box) drawBox(c, drag.box, colors, drag.removing ?? false);
    drawRuler(c, view, colors, ruler);
    drawPlayhead(c, view, colors, ruler);
  }

  private empty(c: CanvasRenderingContext2D, text: string): void {
    const { view, colors } = this.session;
    c.font = `12px ${colors.sans}`;
    c.textAlign = "center";
    c.textBaseline = "middle";
    c.fillStyle = colors.faint;
    c.fillText(text, view.width / 2, view.top + view.plot / 2);
  }
}
