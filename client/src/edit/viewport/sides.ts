// Left and right by name, as keypose.analysis.anatomy reads joint names.

export type Side = "left" | "right" | "";

const PARTS =
  "hipjoint|hip|femur|thigh|upleg|knee|tibia|shin|leg|ankle|foot|toes?|clavicle|collar|shoulder|shldr|humerus|arm|elbow|" +
  "radius|forearm|wrist|hand|fingers?|thumb|index|eye|heel|buttock";
// names of one word that begin with a side: CMU's lfemur, rhumerus
const PREFIXED = new RegExp(`^(l|r)(?:${PARTS})\\d*$`);
const WORDS = /[A-Z]+(?![a-z])|[A-Z][a-z]+|[a-z]+|\d+/g;

/** A name as lower-case words, without a name space: "mixamorig:LeftArm" is left, arm. */
export function wordsOf(name: string): string[] {
  const bare = name.slice(name.lastIndexOf(":") + 1);
  return [...bare.matchAll(WORDS)].map((word) => word[0].toLowerCase());
}

export function sideOf(name: string): Side {
  const words = wordsOf(name);
  for (const side of ["left", "right"] as const) if (words.includes(side) || words.includes(side[0])) return side;
  const joined = words.join("");
  if (joined.startsWith("left")) return "left";
  if (joined.startsWith("right")) return "right";
  const found = PREFIXED.exec(joined);
  return found ? (found[1] === "l" ? "left" : "right") : "";
}

const LETTER = { left: /(?<![A-Za-z])[Ll](?![a-z])|(?<![A-Za-z])l(?=[A-Z])|^l|(?<![A-Za-z])L(?=[A-Z][a-z])/g, right: /(?<![A-Za-z])[Rr](?![a-z])|(?<![A-Za-z])r(?=[A-Z])|^r|(?<![A-Za-z])R(?=[A-Z][a-z])/g };

/** Names that the mirror image of a sided name may have. */
export function mirroredNames(name: string): string[] {
  const side = sideOf(name);
  if (side === "") return [];
  const other = side === "left" ? "right" : "left";
  const found: string[] = [];
  for (const form of [(s: string) => s[0].toUpperCase() + s.slice(1), (s: string) => s, (s: string) => s.toUpperCase()])
    if (name.includes(form(side))) found.push(name.replaceAll(form(side), form(other)));
  for (const match of name.matchAll(LETTER[side])) {
    const upper = match[0] === match[0].toUpperCase();
    const letter = upper ? other[0].toUpperCase() : other[0];
    found.push(name.slice(0, match.index) + letter + name.slice(match.index + 1));
  }
  return found;
}

/** Name -> the name of its mirror image; what has no side is its own, what has a side but no other is left out. */
export function mirrorPairs(names: readonly string[]): Map<string, string> {
  const known = new Set(names), pairs = new Map<string, string>();
  for (const name of names) {
    const side = sideOf(name);
    if (side === "") {
      pairs.set(name, name);
      continue;
    }
    const other = mirroredNames(name).find((n) => n !== name && known.has(n) && sideOf(n) !== side);
    if (other) pairs.set(name, other);
  }
  return pairs;
}
