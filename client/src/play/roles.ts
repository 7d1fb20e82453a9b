// Which parameters of a graph the keys, the stick and the pointer drive. Nothing is special about the built-in graph:
// what a parameter is used for (a blend space, a steering node, a layer, a condition) and its name decide.

import type { PlayNode, PlayParameter, PlayReady } from "../generated/messages";

export interface SpeedRole {
  name: string;
  walk: number;
  run: number;
  back: number;
}

export interface TurnRole {
  name: string;
  most: number;
}

export interface PlaneRole {
  x: string;
  y: string;
  /** Reach of the samples to the left, right, back, front. */
  reach: [number, number, number, number];
}

export interface ActionRole {
  name: string;
  /** A trigger is pulled; the others are on or off. */
  kind: "trigger" | "switch";
  on: number;
  off: number;
  keys: string[];
}

export interface LookRole {
  target: string;
  weight: string;
}

export interface Roles {
  speed: SpeedRole | null;
  turn: TurnRole | null;
  plane: PlaneRole | null;
  actions: ActionRole[];
  look: LookRole | null;
}

const SPEED = /speed|veloc|forward|pace|gait|move|throttle/i;
const TURN = /turn|yaw|steer|heading|rotat/i;
const JUMP = /jump|hop|leap/i;

export function rolesOf(ready: PlayReady): Roles {
  const { nodes } = ready;
  const parameters = new Map(ready.parameters.map((p) => [p.name, p]));
  const used = new Set<string>();
  const take = (name: string) => (used.add(name), name);
  const isFloat = (name: string) => parameters.get(name)?.kind === "float";
  const given = (node: PlayNode, field: string) => node.numbers.find((n) => n.field === field)?.parameter ?? "";

  const aiming = nodes.find((n) => n.kind === "look_at" && n.target);
  const look = aiming ? { target: take(aiming.target), weight: isFloat(given(aiming, "weight")) ? take(given(aiming, "weight")) : "" } : null;

  const steering = nodes.filter((n) => n.kind === "steer").map((n) => given(n, "turn_deg_s"));
  const turning = [...steering, ...parameters.keys()].find((name, n) => isFloat(name) && (n < steering.length || TURN.test(name)));
  const turn = turning ? { name: take(turning), most: parameters.get(turning)!.maximum ?? 120 } : null;

  const lines = nodes.filter((n) => n.kind === "blend_1d" && isFloat(given(n, "parameter")) && !used.has(given(n, "parameter")));
  const driven = lines.find((n) => SPEED.test(given(n, "parameter"))) ?? lines[0];
  const paceName = driven ? given(driven, "parameter") : [...parameters.keys()].find((name) => isFloat(name) && !used.has(name) && SPEED.test(name));
  const speed = paceName ? speedOf(take(paceName), parameters.get(paceName)!, nodes) : null;

  const flat = nodes.find((n) => n.kind === "blend_2d" && isFloat(given(n, "x")) && isFloat(given(n, "y")) && !used.has(given(n, "x")) && !used.has(given(n, "y")));
  const plane = flat ? { x: take(given(flat, "x")), y: take(given(flat, "y")), reach: reachOf(flat, nodes) } : null;

  return { speed, turn, plane, actions: actionsOf(ready, used), look };
}

/** Walking and running speed: the places of the samples of the blend spaces that the parameter drives. */
function speedOf(name: string, parameter: PlayParameter, nodes: PlayNode[]): SpeedRole {
  const spaces = nodes.flatMap((n, index) => (n.kind === "blend_1d" && n.numbers.some((x) => x.parameter === name) ? [index] : []));
  const places = nodes.filter((n) => spaces.includes(n.parent)).flatMap((n) => n.at);
  const ahead = [...places.filter((p) => p > 0), ...(parameter.maximum !== null && parameter.maximum > 0 ? [parameter.maximum] : [])].sort((a, b) => a - b);
  const run = ahead.at(-1) ?? 1;
  return { name, walk: ahead[0] ?? 1, run, back: Math.min(0, ...places, parameter.minimum ?? 0) };
}

function reachOf(flat: PlayNode, nodes: PlayNode[]): [number, number, number, number] {
  const places = nodes.filter((n) => nodes[n.parent] === flat).map((n) => n.at);
  const xs = places.map((p) => p[0]), ys = places.map((p) => p[1]);
  return [Math.min(0, ...xs), Math.max(0, ...xs), Math.min(0, ...ys), Math.max(0, ...ys)];
}

/** Triggers, bools, and floats that only turn something on: the first jump gets the space bar, the others E and digits. */
function actionsOf(ready: PlayReady, used: Set<string>): ActionRole[] {
  const weights = new Set(
    ready.nodes
      .filter((n) => ["layer", "additive", "two_bone", "plant"].includes(n.kind))
      .flatMap((n) => n.numbers.filter((x) => x.field === "weight").map((x) => x.parameter)),
  );
  const able = ready.parameters.filter(
    (p) => !used.has(p.name) && (p.kind === "trigger" || p.kind === "bool" || (p.kind === "float" && weights.has(p.name))),
  );
  const order = (p: PlayParameter) => (p.kind === "trigger" ? 0 : 1);
  const sorted = [...able].sort((a, b) => order(a) - order(b));
  const jump = sorted.find((p) => JUMP.test(p.name)) ?? sorted.find((p) => p.kind === "trigger");
  let digit = 0;
  return sorted.map((p) => {
    const keys = p === jump ? ["Space"] : [...(digit++ === 0 ? ["E"] : []), ...(digit <= 9 ? [String(digit)] : [])];
    return { name: p.name, kind: p.kind === "trigger" ? "trigger" : "switch", on: p.maximum ?? 1, off: p.minimum ?? 0, keys };
  });
}
