// What the tests ask the crowd page.

import { crowd } from "./crowd.svelte";
import type { CrowdStage } from "./stage";

let stage: CrowdStage | null = null;

export function setCrowdStage(present: CrowdStage | null): void {
  stage = present;
}

export const crowdHooks = {
  crowd: () => ({
    ready: crowd.ready !== null && !crowd.opening,
    refused: crowd.refused,
    count: crowd.population?.count ?? 0,
    received: crowd.population?.received ?? 0,
    frames: crowd.frames,
    time: crowd.population?.time ?? 0,
    updated: crowd.population?.updated ?? 0,
    inLevel: [...(crowd.population?.inLevel ?? [])],
    levels: [...(crowd.population?.level ?? [])],
    behaviour: crowd.behaviour,
    paused: crowd.paused,
    followed: crowd.followed,
    radius: crowd.ready?.radius_m ?? 0,
    bytesPerSecond: crowd.bytesPerSecond,
    stats: stage?.stats() ?? null,
  }),
  crowdRoots: () => [...(crowd.population?.roots ?? [])],
  crowdMatrices: (character: number) => crowd.population!.matricesOf(character),
  crowdMorphs: (character: number) => crowd.population!.morphsOf(character),
  crowdCamera: () => ({ position: stage!.orbit.camera.position.toArray(), target: stage!.orbit.target.toArray() }),
  /** Look from here to there. */
  crowdLookFrom: (eye: number[], target: number[]) => {
    stage!.orbit.target.fromArray(target);
    stage!.orbit.camera.position.fromArray(eye);
    stage!.orbit.controls.update();
  },
  /** As a hidden tab does it: nothing is drawn. */
  crowdHide: (hidden: boolean) => stage!.run(!hidden),
};
