// What the tests ask of the 3D view: numbers instead of pixels.

import type { Editor } from "../contract";
import type { Handle } from "./gizmo";
import { Mirror } from "./mirror";
import { takePose } from "./poses";
import { angleBetween, placeOf, type Quat } from "./spaces";
import type { StageEditor } from "./stage-editor";
import { tools } from "./tools.svelte";

type Hooks = Record<string, unknown>;

export function installHooks(editor: Editor, stage: StageEditor): () => void {
  const { view } = stage;
  const actor = () => editor.actor!;
  const onPage = ([x, y]: readonly number[]): [number, number] => {
    const box = view.canvas.getBoundingClientRect();
    return [box.left + x, box.top + y];
  };
  const joint = (name: string) => actor().rig.index(name);
  const hooks: Hooks = {
    /** The gizmo and where its handles are on the page. */
    gizmo: () => {
      view.draw();
      const handles: Partial<Record<Handle, [number, number]>> = {};
      for (const handle of ["x", "y", "z", "yz", "zx", "xy", "screen", "free"] as const) {
        const at = stage.gizmo.pointOf(handle);
        if (at) handles[handle] = onPage(at);
      }
      return { present: stage.gizmo.present, mode: stage.gizmo.mode, centre: onPage(stage.gizmo.centre()), handles, hovered: stage.gizmo.hovered, active: stage.gizmo.active, guides: stage.gizmo.guidePoints() };
    },
    viewTools: (change: Record<string, unknown> = {}) => {
      Object.assign(tools, change);
      const { tool, space, turns, detach, surface, bones, paths, ghosts, text, boxArmed, lookThrough } = tools;
      return { tool, space, turns, detach, surface, bones, paths, ghosts, text, boxArmed, lookThrough, pinned: [...tools.pinned] };
    },
    selectJoints: (names: string[]) => (editor.selectedJoints = names.map(joint)),
    selectedJoints: () => stage.joints.map((j) => actor().rig.names[j]),
    held: () => [...editor.posed.keys()].map((key) => key.replaceAll("\u0000", ".")),
    localOf: (name: string) => takePose(actor(), "", [joint(name)]).joints[name],
    placeOf: (name: string) => placeOf(actor().rig.world, joint(name)),
    /** model_from_joint: three columns and the place. */
    worldOf: (name: string) => [...actor().rig.world.subarray(12 * joint(name), 12 * joint(name) + 12)],
    pointOf: (name: string) => onPage(view.project(actor(), actor().jointPosition(joint(name), actor().measuredRoot.clone()))),
    angleBetween: (a: Quat, b: Quat) => angleBetween(a, b),
    camera: () => ({ parallel: view.orbit.isParallel, position: view.orbit.camera.position.toArray(), target: view.orbit.target.toArray() }),
    paths: () => ({ complete: stage.paths.complete, paths: stage.paths.report() }),
    pathKeyPoint: (name: string, time: number) => {
      const path = stage.paths.report().find((p) => p.joint === joint(name));
      const n = path?.times.findIndex((t) => Math.abs(t - time) < 1e-4) ?? -1;
      if (!path || n < 0) return null;
      return onPage(view.project(actor(), actor().measuredRoot.clone().fromArray(path.positions, 3 * n)));
    },
    jointAt: (x: number, y: number) => {
      const box = view.canvas.getBoundingClientRect(), found = stage.jointAt(x - box.left, y - box.top);
      return found < 0 ? null : actor().rig.names[found];
    },
    ghostPlaces: () => actor().ghostTimes(),
    /** The mirror image of the pose that is shown, and twice mirrored. */
    mirrorTwice: () => {
      const mirror = new Mirror(actor().rig, actor().morphNames), pose = takePose(actor(), "", null);
      const once = mirror.pose(pose);
      return { pose, once, twice: mirror.pose(once), normal: mirror.normal };
    },
    /** Places of all joints of a pose, without showing it. */
    placesOf: (pose: ReturnType<typeof takePose>) => {
      const { rig } = actor();
      const kept = rig.pose, local = structuredClone({ translations: kept.translations, rotations: kept.rotations, scales: kept.scales, morphs: kept.morphs });
      for (const [name, { translation, rotation, scale }] of Object.entries(pose.joints)) {
        const j = rig.index(name);
        local.translations.set(translation, 3 * j);
        local.rotations.set(rotation, 4 * j);
        local.scales.set(scale, 3 * j);
      }
      const world = new Float64Array(12 * rig.count);
      rig.solve(local as typeof kept, world);
      return Object.fromEntries(rig.names.map((name, j) => [name, [...placeOf(world, j)]]));
    },
  };
  const { keypose } = window as unknown as { keypose?: { test: Hooks & { stage?: Hooks } } };
  if (keypose) keypose.test.viewport = hooks;
  return () => {
    if (keypose?.test.viewport === hooks) delete keypose.test.viewport;
  };
}
