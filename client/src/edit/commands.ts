// One table of everything that can be asked for: the command palette, both key maps and the help page are made of it.

/** Where the pointer is: a key may mean one thing over the 3D view and another over the curves. */
export type Area = "viewport" | "curves" | "";
export type KeyMap = "blender" | "maya";

export interface Command {
  /** Unique, as "keys.insert". */
  readonly id: string;
  readonly label: string;
  /** Heading on the help page. */
  readonly group: string;
  /** Keys as "Ctrl+Shift+Z", "I", "Alt+ArrowUp", "Space"; several for one command are separated by a blank. */
  readonly blender?: string;
  readonly maya?: string;
  /** Keys count only while the pointer is over this part of the page; everywhere where it is not said. */
  readonly area?: Area;
  /** Whether it can be done now; always where it is not said. */
  readonly when?: () => boolean;
  readonly run: (event?: KeyboardEvent) => void;
}

const table = new Map<string, Command>();

/** Add commands; returns what takes them away again (for a component's unmount). */
export function register(...commands: Command[]): () => void {
  for (const command of commands) table.set(command.id, command);
  return () => {
    for (const command of commands) if (table.get(command.id) === command) table.delete(command.id);
  };
}

export function allCommands(): Command[] {
  return [...table.values()];
}

const GROUPS = ["Project", "Edit", "Keys", "Time", "Pose", "Rig", "Select", "Layers", "View", "Curves", "Window"];

/** All commands, group by group. */
export function sortedCommands(): Command[] {
  const place = (c: Command) => (GROUPS.includes(c.group) ? GROUPS.indexOf(c.group) : GROUPS.length);
  return allCommands().sort((a, b) => place(a) - place(b));
}

/** The keys of a command in a key map. */
export function keysOf(command: Command, map: KeyMap): string[] {
  return (command[map] ?? "").split(" ").filter(Boolean);
}

/** The spellings of a pressed key, the most exact first. */
export function spellings(event: KeyboardEvent): string[] {
  const letter = /^Key[A-Z]$/.test(event.code) && (event.altKey || event.ctrlKey) ? event.code.slice(3) : null;
  const key = letter ?? (event.key === " " ? "Space" : event.key.length === 1 ? event.key.toUpperCase() : event.key);
  const pad = /^Numpad/.test(event.code) ? event.code : null;
  const head = `${event.ctrlKey || event.metaKey ? "Ctrl+" : ""}${event.altKey ? "Alt+" : ""}`;
  if (pad) return [`${head}${event.shiftKey ? "Shift+" : ""}${pad}`, `${head}${key}`];
  if (!event.shiftKey) return [`${head}${key}`];
  // what Shift makes of , and . on many keyboards
  const bare = { "<": ",", ">": "." }[key] ?? key;
  return [`${head}Shift+${bare}`, ...(key.length === 1 && !/[A-Z]/.test(key) ? [`${head}${key}`] : [])];
}

/** The command of a pressed key: those of the part under the pointer come first. */
export function commandFor(event: KeyboardEvent, map: KeyMap, area: Area): Command | null {
  for (const spelling of spellings(event)) {
    const found = allCommands().filter((c) => keysOf(c, map).includes(spelling) && (!c.area || c.area === area));
    const best = found.find((c) => c.area === area && (c.when?.() ?? true)) ?? found.find((c) => c.when?.() ?? true);
    if (best) return best;
  }
  return null;
}
