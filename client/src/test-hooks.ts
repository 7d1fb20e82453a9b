// What the tests ask the page: numbers instead of pixels. Nothing here changes what a user sees.

import { Vector3 } from "three";
import { crowd } from "./crowd/crowd.svelte";
import { crowdHooks } from "./crowd/test-hooks";
import { deformedVertices } from "./view/parts";
import { editor } from "./edit/editor.svelte";
import { project } from "./edit/project.svelte";
import { editHooks } from "./edit/test-hooks";
import { play } from "./play/play.svelte";
import { playHooks } from "./play/test-hooks";
import { retarget } from "./retarget/retarget.svelte";
import { retargetHooks } from "./retarget/test-hooks";
import type { Studio } from "./studio.svelte";

export function installHooks(studio: Studio): void {
  const actorAt = (n: number) => {
    const actor = studio.actors[n];
    if (!actor) throw new Error(`no character ${n}; there are ${studio.actors.length}`);
    return actor;
  };
  const test = {
    /** Everything that was announced has been loaded. */
    ready: () => studio.settled && studio.jobs.size === 0,
    state: () => ({
      files: studio.files.map((f) => ({ name: f.name, format: f.format, notes: f.notes })),
      actors: studio.actors.map((a) => ({
        name: a.name,
        joints: a.rig.count,
        vertices: a.vertices,
        morphs: a.morphNames.length,
        animation: a.animation?.name ?? null,
        visible: a.visible,
        x: a.root.position.x,
      })),
      animations: studio.animations.map((a) => ({ name: a.name, start: a.start, duration: a.duration, rate: a.rate, frames: a.frames })),
      active: studio.active?.name ?? null,
      animation: studio.animation?.name ?? null,
      time: studio.view.clock.time,
      playing: studio.playing,
      speed: studio.speed,
      mode: studio.mode,
      range: [studio.start, studio.end],
      display: { ...studio.display },
      selected: studio.selected >= 0 ? (studio.active?.rig.names[studio.selected] ?? null) : null,
      theme: studio.theme,
      toasts: studio.toasts.map((t) => ({ kind: t.kind, title: t.title, message: t.message })),
    }),
    jointNames: (n: number) => actorAt(n).rig.names,
    /** Model-space joint positions at a time of the character's animation, without changing what is shown. */
    jointPositions: (n: number, time: number): number[][] => {
      const actor = actorAt(n);
      actor.evaluate(time);
      const { world } = actor.rig;
      const positions = actor.rig.names.map((_, j) => [...world.subarray(12 * j + 9, 12 * j + 12)]);
      studio.view.invalidatePose();
      return positions;
    },
    /** Joint positions as they are shown now. */
    shownPositions: (n: number): number[][] => {
      const { rig } = actorAt(n);
      return rig.names.map((_, j) => [...rig.world.subarray(12 * j + 9, 12 * j + 12)]);
    },
    /** Vertices of a part after morphing and skinning, from the same matrices that the shader gets. */
    skinnedVertices: (n: number, part: number, time: number): number[] => {
      const actor = actorAt(n);
      actor.evaluate(time);
      const vertices = [...deformedVertices(actor.sources[part], actor.rig.world, actor.rig.pose.morphs)];
      studio.view.invalidatePose();
      return vertices;
    },
    /** The same vertices as they are shown now, on the canvas in CSS pixels. */
    verticesOnScreen: (n: number): [number, number][] => {
      const actor = actorAt(n);
      return actor.sources.flatMap((source) => {
        const vertices = deformedVertices(source, actor.rig.world, actor.rig.pose.morphs);
        return Array.from({ length: vertices.length / 3 }, (_, v): [number, number] => {
          const [x, y] = studio.view.project(actor, new Vector3().fromArray(vertices, 3 * v));
          return [x, y];
        });
      });
    },
    morphs: (n: number) => [...actorAt(n).rig.pose.morphs],
    /** Where a joint is on the canvas, in CSS pixels of the page. */
    jointOnScreen: (n: number, joint: number): [number, number] => {
      const actor = actorAt(n);
      const box = studio.view.canvas.getBoundingClientRect();
      const [x, y] = studio.view.project(actor, actor.jointPosition(joint, actor.measuredRoot.clone()));
      return [box.left + x, box.top + y];
    },
    camera: () => ({ position: studio.view.orbit.camera.position.toArray(), target: studio.view.orbit.target.toArray() }),
    ...playHooks,
    ...crowdHooks,
    ...editHooks,
    ...retargetHooks,
    stats: () => studio.view.stats(),
    resetStats: () => studio.view.resetStats(),
  };
  Object.assign(window, { keypose: { test, studio, play, crowd, editor, project, retarget } });
}

