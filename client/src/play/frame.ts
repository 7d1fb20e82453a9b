// A step of the graph as typed arrays that look into the received message.

import type { Envelope, PlayFrame } from "../generated/messages";
import { Arrays, type Container } from "../net/container";

/** Kinds of transitions, as `PlayFrame.machines` counts them. */
export const TRANSITION_KINDS = ["", "crossfade", "frozen", "inertial", "dead"] as const;

export interface Frame {
  readonly data: PlayFrame;
  readonly pose: Float32Array;
  readonly morphs: Float32Array;
  readonly contacts: Float32Array;
  readonly parameters: Float32Array;
  readonly shares: Float32Array;
  readonly phases: Float32Array;
  readonly machines: Float32Array;
  readonly syncs: Float32Array;
  readonly contributions: Float32Array;
  /** When it arrived, in milliseconds of this page. */
  readonly arrived: number;
}

export function readFrame(data: PlayFrame, container: Container<Envelope>): Frame {
  const { float32 } = new Arrays(container);
  return {
    data,
    pose: float32(data.pose),
    morphs: float32(data.morphs),
    contacts: float32(data.contacts),
    parameters: float32(data.parameters),
    shares: float32(data.shares),
    phases: float32(data.phases),
    machines: float32(data.machines),
    syncs: float32(data.syncs),
    contributions: float32(data.contributions),
    arrived: performance.now(),
  };
}
