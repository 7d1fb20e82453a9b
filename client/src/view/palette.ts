// Colours of the stage in both themes; the page's own colours are in app.css.

import * as THREE from "three";

export type Theme = "dark" | "light";

export interface Palette {
  backgroundTop: string;
  backgroundBottom: string;
  floor: THREE.Color;
  line: THREE.Color;
  shadow: THREE.Color;
  shadowStrength: number;
  bone: THREE.Color;
  overlayBone: THREE.Color;
  accent: THREE.Color;
  hover: THREE.Color;
  /** Of several selected joints, those that are not the active one. */
  selected: THREE.Color;
  /** Set by hand and not keyed. */
  held: THREE.Color;
  ghostBefore: THREE.Color;
  ghostAfter: THREE.Color;
}

const color = (hex: number) => new THREE.Color(hex);

export const PALETTES: Record<Theme, Palette> = {
  dark: {
    backgroundTop: "#24272d",
    backgroundBottom: "#14161a",
    floor: color(0x2b2f36),
    line: color(0x596070),
    shadow: color(0x07080a),
    shadowStrength: 0.62,
    bone: color(0xcfd3da),
    overlayBone: color(0xc9d0da),
    accent: color(0xffab2e),
    hover: color(0xffd79a),
    selected: color(0xd9822b),
    held: color(0xc07cff),
    ghostBefore: color(0x4aa3ff),
    ghostAfter: color(0xff6b8b),
  },
  light: {
    backgroundTop: "#f3f2ee",
    backgroundBottom: "#d3d2cd",
    floor: color(0xdcdad4),
    line: color(0x9a978f),
    shadow: color(0x3a3833),
    shadowStrength: 0.42,
    bone: color(0x7d848f),
    overlayBone: color(0xdde2ea),
    accent: color(0xe07a00),
    hover: color(0xf0b060),
    selected: color(0xc46a1a),
    held: color(0x8a3ffc),
    ghostBefore: color(0x1666c5),
    ghostAfter: color(0xcc2b55),
  },
};
