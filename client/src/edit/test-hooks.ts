// What the tests ask the edit page.

import { studio } from "../studio.svelte";
import { allCommands } from "./commands";
import type { EditCurve } from "./contract";
import { editor } from "./editor.svelte";
import { project } from "./project.svelte";

const told = (curve: EditCurve) => ({
  kind: curve.kind,
  times: [...curve.times],
  values: [...curve.values],
  modes: [...curve.modes],
  types: curve.types && [...curve.types],
  before: curve.before,
  after: curve.after,
});
const text = (key: string) => key.split("\u0000").filter(Boolean).join(".");

export const editHooks = {
  edit: () => ({
    open: editor.open,
    settled: editor.waiting === 0 && studio.jobs.size === 0,
    name: project.status?.name ?? "",
    path: project.status?.path ?? "",
    revision: project.status?.revision ?? -1,
    unsaved: project.unsaved,
    undo: project.status?.undo ?? "",
    redo: project.status?.redo ?? "",
    past: [...project.past],
    future: [...project.future],
    recoverable: project.recoverable.map((r) => ({ name: r.name, edits: r.edits })),
    dialog: project.dialog,
    characters: editor.document.characters.map((c) => ({ name: c.name, timeline: c.timeline })),
    timeline: editor.timeline && {
      name: editor.timeline.name,
      range: [editor.timeline.start, editor.timeline.end],
      rate: editor.timeline.rate,
      holdFrames: editor.timeline.holdFrames,
      markers: editor.timeline.markers.map((m) => [m.name, m.time]),
      layers: editor.timeline.layers.map((l) => ({
        name: l.name,
        mode: l.mode,
        influence: typeof l.influence === "number" ? l.influence : told(l.influence),
        joints: { ...l.joints },
        muted: l.muted,
        solo: l.solo,
        locked: l.locked,
        placements: l.placements.map((p) => ({ ...p, timeWarp: null, weight: null })),
      })),
    },
    layer: editor.layer?.name ?? null,
    clip: editor.clip?.name ?? null,
    channels: editor.channels.map((c) => text(c.channel.key)),
    selectedJoints: editor.selectedJoints.map((j) => editor.actor!.rig.names[j]),
    selectedKeys: [...editor.selection].map(([key, indices]) => [text(key), [...indices]]),
    span: editor.span && [...editor.span],
    posed: [...editor.posed].map(([key, value]) => [text(key), [...value]]),
    frame: studio.time * editor.rate,
    playing: studio.playing,
    autoKey: editor.autoKey,
    snap: editor.snap,
  }),
  /** All curves of the active clip as they are shown. */
  editCurves: () => Object.fromEntries([...(editor.clip?.curves ?? [])].map(([key, curve]) => [text(key), told(curve)])),
  /** Whether the page's document has the same arrays as the server's, by asking for the whole of it again. */
  editRefetch: () => {
    studio.connection.send({ type: "project_watch" });
  },
  /** Local translation, rotation and scale of a joint as shown at a frame. */
  editLocal: (name: string, frame: number) => {
    const actor = editor.actor!, joint = actor.rig.index(name);
    actor.evaluate(frame / editor.rate);
    const { pose } = actor.rig;
    const found = {
      translation: [...pose.translations.subarray(3 * joint, 3 * joint + 3)],
      rotation: [...pose.rotations.subarray(4 * joint, 4 * joint + 4)],
      scale: [...pose.scales.subarray(3 * joint, 3 * joint + 3)],
      position: [...actor.rig.world.subarray(12 * joint + 9, 12 * joint + 12)],
    };
    studio.view.invalidatePose();
    return found;
  },
  editCommands: () => allCommands().map((c) => ({ id: c.id, label: c.label, blender: c.blender ?? "", maya: c.maya ?? "", area: c.area ?? "" })),
  /** Do what a command does, as the palette would. */
  editRun: (id: string) => {
    const command = allCommands().find((c) => c.id === id);
    if (!command) throw new Error(`no command ${id}`);
    command.run();
  },
};
