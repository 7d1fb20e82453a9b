// Colours of the drawings: the page's tokens, the three axes, and quiet hues for what has no axis.

import { readColors, type Colors } from "../../play/colors";

export interface CurveColors extends Colors {
  readonly ground: string;
  readonly axes: readonly string[];
  readonly extra: readonly string[];
  readonly danger: string;
}

export function readCurveColors(element: Element): CurveColors {
  const colors = readColors(element), style = getComputedStyle(element);
  const get = (name: string) => style.getPropertyValue(name).trim();
  const { dark } = colors;
  return {
    ...colors,
    ground: dark ? "#131417" : "#fdfcfa",
    danger: get("--danger"),
    axes: dark ? ["#ff5f66", "#58c46b", "#5b93ff"] : ["#d3373d", "#2f8f44", "#2f67e0"],
    extra: dark ? ["#c58bff", "#4cc9c0", "#ff9dc4", "#9fc65a", "#7fb2e8", "#d7a86e"] : ["#8a4fd0", "#0b857c", "#c2417f", "#5c7f1c", "#3a73b0", "#996327"],
  };
}

/** Place in the palette: 0 to 2 the axes, from 3 on the hues of scalars, by name so that they stay the same. */
export function hueOf(name: string): number {
  let hash = 0x811c9dc5;
  for (let n = 0; n < name.length; n++) hash = Math.imul(hash ^ name.charCodeAt(n), 0x01000193);
  hash = Math.imul(hash ^ (hash >>> 15), 0x2c1b3c6d);
  return 3 + (((hash ^ (hash >>> 13)) >>> 0) % 6);
}

export function paint(colors: CurveColors, hue: number): string {
  return hue < 3 ? colors.axes[hue] : colors.extra[(hue - 3) % colors.extra.length];
}
