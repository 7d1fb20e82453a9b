// The help page is the table of commands in the chosen key map.

import type { Shortcut } from "../shortcuts";
import { keysOf, sortedCommands, type KeyMap } from "./commands";

const AREAS = { viewport: ", pointer over the 3D view", curves: ", pointer over them", "": "" };

export function editShortcuts(map: KeyMap): Shortcut[] {
  return sortedCommands().flatMap((c) => {
    const keys = keysOf(c, map);
    return keys.length > 0 ? [{ keys: keys[0], does: c.label.replace("…", ""), group: `${c.group}${AREAS[c.area ?? ""]}`, run: c.run }] : [];
  });
}
