// Documents for the harness: a few curves of all kinds, hundreds of dense ones, rotations.

import { channelOf, Mode, Tangent, type EditCurve, type EditDocument, type Kind, type Property } from "../src/edit/contract";
import { newLayer, basePlacement } from "../src/edit/document";
import { refreshTangents, withHandles, withTangents } from "../src/edit/keys";

const RATE = 25;

function curve(target: string, property: Property, kind: Kind, frames: number[], rows: number[][], mode: Mode, component: number | null = null, type: Tangent | null = Tangent.Clamped): EditCurve {
  const bare: EditCurve = {
    channel: channelOf(target, property, component),
    kind,
    components: rows[0].length,
    times: Float64Array.from(frames, (f) => f / RATE),
    values: Float64Array.from(rows.flat()),
    modes: new Uint8Array(frames.length).fill(mode),
    inTangents: null,
    outTangents: null,
    inHandles: null,
    outHandles: null,
    types: type === null ? null : new Uint8Array(2 * frames.length).fill(type),
    before: "hold",
    after: "hold",
  };
  const full = mode === Mode.Bezier ? withHandles(bare) : mode === Mode.Hermite ? withTangents(bare) : bare;
  return refreshTangents(full);
}

function document(curves: EditCurve[], end: number, markers: boolean): EditDocument {
  const clip = { name: "wave", rate: RATE, curves: new Map(curves.map((c) => [c.channel.key, c])), eulerOrders: {} };
  const timeline = {
    name: "main",
    layers: [newLayer("Base", [basePlacement("wave")])],
    rate: RATE,
    start: 0,
    end: end / RATE,
    holdFrames: 0,
    markers: markers ? [{ time: 12 / RATE, name: "contact" }, { time: 48 / RATE, name: "apex" }, { time: 84 / RATE, name: "settle" }] : [],
  };
  return { name: "test", clips: new Map([["wave", clip]]), timelines: new Map([["main", timeline]]), poses: new Map(), rigs: [], characters: [{ name: "anna", scene: "s1", timeline: "main" }] };
}

const rad = (degrees: number) => (degrees * Math.PI) / 180;

function few(markers: boolean): EditDocument {
  const ball = curve("ball", "translation", "vector", [0, 12, 24, 36, 48, 60, 72, 84, 96], [
    [-2, 1.8, 0], [-1.5, 0, 0], [-1, 1.3, 0.02], [-0.5, 0, 0.04], [0, 0.9, 0.04], [0.5, 0, 0.05], [1, 0.5, 0.06], [1.5, 0, 0.06], [1.8, 0, 0.06],
  ], Mode.Bezier);
  const squash = curve("ball", "scale", "vector", [0, 10, 12, 15, 34, 36, 39], [[1, 1, 1], [0.9, 1.22, 0.9], [1.25, 0.62, 1.25], [0.93, 1.15, 0.93], [0.95, 1.1, 0.95], [1.15, 0.74, 1.15], [1, 1, 1]], Mode.Bezier);
  const arm = curve("LeftArm", "euler", "euler", [0, 12, 24, 48, 60, 96], [[0, 0, 0], [rad(12), rad(-8), rad(64)], [rad(20), rad(-14), rad(92)], [rad(4), rad(-20), rad(40)], [rad(10), rad(6), rad(71)], [0, 0, 0]], Mode.Bezier);
  const hand = curve("LeftHand", "euler", "euler", [24, 30, 36, 42, 48], [[rad(0), 0, 0], [rad(32), 0, rad(5)], [rad(-30), 0, rad(-3)], [rad(28), 0, rad(4)], [0, 0, 0]], Mode.Bezier, null, Tangent.Auto);
  const turn = (degrees: number) => [Math.cos(rad(degrees) / 2), 0, Math.sin(rad(degrees) / 2), 0];
  const head = curve("Head", "rotation", "rotation", [0, 20, 40, 70, 96], [turn(0), turn(50), turn(-40), turn(25), turn(0)], Mode.Squad, null, null);
  const smile = curve("smile", "weight", "scalar", [0, 30, 45, 80], [[0], [0], [1], [0.2]], Mode.Hermite);
  const blink = curve("blink", "weight", "scalar", [0, 20, 22, 25, 70, 72, 75], [[0], [0], [1], [0], [0], [1], [0]], Mode.Linear, null, null);
  const shown = curve("hat visible", "value", "boolean", [0, 50], [[1], [0]], Mode.Step, null, null);
  const lift = curve("hips", "translation", "scalar", [0, 30, 60], [[0.95], [1.02], [0.95]], Mode.Bezier, 1);
  return document([ball, squash, arm, hand, head, lift, smile, { ...blink, after: "cycle" }, shown], 96, markers);
}

/** 200 channels of 500 keys. */
function dense(): EditDocument {
  const curves: EditCurve[] = [];
  const frames = Array.from({ length: 500 }, (_, k) => 2 * k);
  for (let n = 0; n < 200; n++) {
    const joint = `joint_${String(n >> 1).padStart(2, "0")}`;
    const rows = frames.map((f) => [0, 1, 2].map((c) => (0.5 + 0.3 * Math.sin(n + c)) * Math.sin((0.02 + 0.004 * (n % 7)) * f + n + 2 * c) + 0.1 * Math.sin(0.37 * f + n * c)));
    curves.push(n % 2 === 0 ? curve(joint, "translation", "vector", frames, rows, Mode.Bezier) : curve(joint, "euler", "euler", frames, rows, Mode.Bezier));
  }
  return document(curves, 998, false);
}

export const scenes: Record<string, (markers: boolean) => EditDocument> = { few, dense };
