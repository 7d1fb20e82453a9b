// The rows that the channel tree and the dope sheet share: everything, then targets, their properties and components.

import type { EditCurve, Property } from "../contract";
import { hueOf } from "./colors";

export interface Row {
  readonly id: string;
  readonly kind: "all" | "target" | "property" | "component";
  readonly depth: number;
  readonly label: string;
  /** Keys of the channels below; the channel itself for a component. */
  readonly channels: readonly string[];
  /** Which component of its only channel a component row is, and its colour. */
  readonly component: number;
  readonly hue: number;
  readonly parent: boolean;
  readonly open: boolean;
}

/** One component of one curve: what the graph draws as a line. */
export interface Line {
  readonly id: string;
  readonly channel: string;
  readonly component: number;
  readonly hue: number;
  /** Shown value of a value: degrees for angles. */
  readonly unit: number;
  readonly label: string;
}

const NAMES: Record<Property, string> = { translation: "Location", rotation: "Rotation", euler: "Rotation", scale: "Scale", weight: "Weight", value: "Value" };
const DEGREES = 180 / Math.PI;

export const lineId = (channel: string, component: number) => `${channel}\u0000${component}`;

function componentNames({ kind, channel, components }: EditCurve): string[] {
  if (channel.component !== null) return ["XYZ"[channel.component]];
  if (kind === "rotation") return ["W", "X", "Y", "Z"];
  if (kind === "color") return ["R", "G", "B", "A"].slice(0, components);
  return components === 1 ? [""] : [..."XYZW"].slice(0, components);
}

function hueOfComponent({ kind, channel, components }: EditCurve, component: number): number {
  if (channel.component !== null) return channel.component;
  if (kind === "rotation") return component === 0 ? 3 : component - 1;
  return components === 1 ? hueOf(channel.target + channel.property) : component < 3 ? component : 3;
}

export const isAngle = ({ channel }: EditCurve) => channel.property === "euler";

/** The lines of a curve, with names that stand alone. */
export function linesOf(curve: EditCurve): Line[] {
  const { channel } = curve;
  const names = componentNames(curve);
  return names.map((name, component) => ({
    id: lineId(channel.key, component),
    channel: channel.key,
    component,
    hue: hueOfComponent(curve, component),
    unit: isAngle(curve) ? DEGREES : 1,
    label: `${channel.target} ${NAMES[channel.property].toLowerCase()}${curve.kind === "rotation" ? " quaternion" : ""}${name ? ` ${name}` : ""}`,
  }));
}

/** Rows of these channels; `closed` are ids of rows whose children are not shown. */
export function rowsOf(curves: readonly EditCurve[], toggled: ReadonlySet<string>, query: string): Row[] {
  const words = query.trim().toLowerCase().split(/\s+/).filter(Boolean);
  const matches = (text: string) => words.every((word) => text.includes(word));
  const targets = new Map<string, Map<string, EditCurve[]>>();
  const shown: string[] = [];
  for (const curve of curves) {
    const { channel } = curve;
    if (words.length > 0 && !matches(`${channel.target} ${NAMES[channel.property]} ${channel.property} ${componentNames(curve).join(" ")}`.toLowerCase())) continue;
    shown.push(channel.key);
    let properties = targets.get(channel.target);
    if (!properties) targets.set(channel.target, (properties = new Map()));
    // one row for x, y and z of their own and for all three together
    const property = `${channel.property}`;
    properties.set(property, [...(properties.get(property) ?? []), curve]);
  }
  // rows of targets are open and those of properties closed until they are toggled
  const few = targets.size <= 12;
  const isOpen = (id: string, open: boolean) => (toggled.has(id) ? !open : open);
  const row = (kind: Row["kind"], id: string, depth: number, label: string, channels: readonly string[], parent: boolean, open: boolean, component = 0, hue = -1): Row => ({
    id, kind, depth, label, channels, component, hue, parent, open,
  });
  const rows: Row[] = [row("all", "all", 0, words.length > 0 ? "Found" : "All channels", shown, false, true)];
  for (const [target, properties] of targets) {
    const all = [...properties.values()].flatMap((own) => own.map((c) => c.channel.key));
    const id = `t:${target}`, open = isOpen(id, few);
    rows.push(row("target", id, 0, target, all, true, open));
    if (!open) continue;
    for (const [property, own] of properties) {
      const parts = own.flatMap((curve) => componentNames(curve).map((name, component) => ({ curve, name, component })));
      const label = NAMES[property as Property] + (own.some((c) => c.kind === "rotation") ? " (quaternion)" : "");
      const single = parts.length === 1 && parts[0].name === "";
      const propertyId = `p:${target}\u0000${property}`, unfolded = !single && isOpen(propertyId, false);
      const keys = own.map((c) => c.channel.key);
      rows.push(row("property", propertyId, 1, label, keys, !single, unfolded, 0, single ? hueOfComponent(own[0], 0) : -1));
      if (!unfolded) continue;
      for (const { curve, name, component } of parts)
        rows.push(row("component", `c:${lineId(curve.channel.key, component)}`, 2, name || "Value", [curve.channel.key], false, false, component, hueOfComponent(curve, component)));
    }
  }
  return rows;
}
