// The stage of the play page while it is there: for keys and tests, which are no part of its component.

import type { PlayStage } from "./stage";

let present: PlayStage | null = null;

export function stageOf(): PlayStage | null {
  return present;
}

export function setStage(stage: PlayStage | null): void {
  present = stage;
}
