// The help page is the table of commands in the chosen key map.

import type { Shortcut } from "../shortcuts";
import { allCommands, keysOf, type KeyMap } from "./commands";

const AREAS = { viewport: " (over the 3D view)", curves: " (over the curves)", "": "" };

export function editShortcuts(map: KeyMap): Shortcut[] {
  return allCommands().flatMap((c) => {
    const keys = keysOf(c, map);
    return keys.length > 0 ? [{ keys: keys[0], does: `${c.label.replace("…", "")}${AREAS[c.area ?? ""]}`, group: c.group, run: c.run }] : [];
  });
}
