// Groups of morph channels, found from the names that face rigs use.

const RULES: [string, RegExp][] = [
  ["Visemes", /^(viseme|v_|vrc\.v)/i],
  ["Brows", /brow/i],
  ["Cheeks", /cheek/i],
  ["Eyes", /(^eye|blink|lid|squint|look(up|down|in|out|left|right))/i],
  ["Nose", /nose|sneer/i],
  ["Jaw", /^jaw/i],
  ["Tongue", /tongue/i],
  ["Mouth", /mouth|lip|smile|frown|pucker|funnel/i],
];

export interface MorphGroup {
  name: string;
  channels: number[];
}

export function groupMorphs(names: string[]): MorphGroup[] {
  const groups = new Map<string, number[]>();
  names.forEach((name, channel) => {
    const bare = name.replace(/^.*[.:/]/, "");
    const group = RULES.find(([, rule]) => rule.test(bare))?.[0] ?? "Shapes";
    groups.set(group, [...(groups.get(group) ?? []), channel]);
  });
  const order = ["Shapes", "Brows", "Eyes", "Nose", "Cheeks", "Mouth", "Jaw", "Tongue", "Visemes"];
  return order.flatMap((name) => (groups.has(name) ? [{ name, channels: groups.get(name)! }] : []));
}
