// What the tests ask the play page.

import { studio } from "../studio.svelte";
import { play } from "./play.svelte";
import { stageOf } from "./stage-access";

export const playHooks = {
  play: () => {
    const { playing, frame } = play;
    const stage = stageOf();
    return {
      page: studio.page,
      playing: playing !== null,
      refused: play.refused,
      graph: play.graphId,
      number: frame?.data.number ?? 0,
      received: play.received,
      time: frame?.data.time_s ?? 0,
      root: frame?.data.root ?? [0, 0, 0],
      states: playing && frame ? Object.fromEntries(playing.tree.machines.map((m) => [m.data.name, m.data.states[frame.machines[4 * m.machine]]])) : {},
      shares: playing && frame ? playing.tree.nodes.map((n) => ({ name: n.data.name, kind: n.data.kind, parent: n.data.parent, share: frame.shares[n.index] })) : [],
      parameters: playing ? Object.fromEntries(playing.ready.parameters.map((p) => [p.name, play.used(p.name)])) : {},
      contributions: playing && frame ? Object.fromEntries(playing.ready.contributors.map((name, n) => [name, frame.contributions[n] ?? 0])) : {},
      marks: playing?.history.marks.map((m) => m.name) ?? [],
      cuts: playing?.history.cuts.map((c) => c.kind) ?? [],
      contacts: playing?.history.contacts.map((spans) => spans.length) ?? [],
      roles: playing?.roles ?? null,
      paused: play.paused,
      recorded: play.recordedS,
      takes: play.takes,
      latencies: play.latencies,
      look: play.look,
      joint: play.joint,
      heading: stage?.view.heading ?? 0,
      stats: stage?.stats() ?? null,
    };
  },
  resetPlayStats: () => stageOf()?.resetStats(),
  playJoints: () => {
    const { rig } = play.playing!.actor;
    return rig.names.map((_, j) => [...rig.world.subarray(12 * j + 9, 12 * j + 12)]);
  },
  playJointOnScreen: (joint: number): [number, number] => {
    const stage = stageOf()!, box = stage.canvas.getBoundingClientRect(), [x, y] = stage.project(joint);
    return [box.left + x, box.top + y];
  },
  /** A gamepad that is not there: axes and pressed buttons; null takes it away. */
  gamepad: (pad: { axes: number[]; buttons: number[] } | null) => {
    const buttons = Array.from({ length: 17 }, (_, n) => ({ pressed: pad?.buttons.includes(n) ?? false, value: pad?.buttons.includes(n) ? 1 : 0 }));
    play.playing!.driver.fakePad = pad && { axes: pad.axes, buttons };
  },
  /** As a hidden tab does it: nothing is drawn. */
  hide: (hidden: boolean) => stageOf()?.run(!hidden),
};
