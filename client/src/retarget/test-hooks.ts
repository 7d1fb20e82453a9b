// What the tests ask the retarget page.

import { SIDES, type SideName } from "./pair";
import { retarget } from "./retarget.svelte";

export const retargetHooks = {
  retarget: () => ({
    settled: !retarget.busy && !retarget.loading.source && !retarget.loading.target && retarget.subjects.source !== null && retarget.subjects.target !== null && (retarget.done !== null || retarget.error !== ""),
    subjects: Object.fromEntries(SIDES.map((side) => [side, retarget.subjects[side] && { reference: retarget.subjects[side].reference, name: retarget.subjects[side].name, animation: retarget.subjects[side].animation }])),
    performs: Object.fromEntries(SIDES.map((side) => [side, retarget.actor(side)?.animation?.name ?? null])),
    done: retarget.done,
    error: retarget.error,
    stale: retarget.stale,
    tab: retarget.tab,
    side: retarget.side,
    role: retarget.role,
    roles: { source: { ...retarget.table("source") }, target: { ...retarget.table("target") } },
    byHand: { source: retarget.maps.source !== null, target: retarget.maps.target !== null },
    missing: { source: retarget.missing("source"), target: retarget.missing("target") },
    undo: retarget.history.undoLabel,
    time: retarget.now,
    times: Object.fromEntries(SIDES.map((side) => [side, retarget.stages?.views[side].clock.time ?? NaN])),
    playing: retarget.playing,
    look: { ...retarget.look },
    prints: Object.fromEntries(SIDES.map((side) => [side, retarget.prints[side].map((print) => ({ ...print }))])),
    options: JSON.parse(JSON.stringify(retarget.options)) as unknown,
  }),
  /** Model-space joint positions of one side as they are shown now. */
  retargetPositions: (side: SideName): number[][] => {
    const { rig } = retarget.actor(side)!;
    return rig.names.map((_, j) => [...rig.world.subarray(12 * j + 9, 12 * j + 12)]);
  },
  retargetJoints: (side: SideName) => retarget.actor(side)!.rig.names,
  /** Where a joint is, in CSS pixels of the page. */
  retargetOnScreen: (side: SideName, joint: number): [number, number] => {
    const actor = retarget.actor(side)!, view = retarget.stages!.views[side], box = view.canvas.getBoundingClientRect();
    const [x, y] = view.project(actor, actor.jointPosition(joint, actor.measuredRoot.clone()));
    return [box.left + x, box.top + y];
  },
  /** Camera and target of both sides. */
  retargetCameras: () => Object.fromEntries(SIDES.map((side) => [side, { position: retarget.stages!.views[side].orbit.camera.position.toArray(), target: retarget.stages!.views[side].orbit.target.toArray() }])),
};
