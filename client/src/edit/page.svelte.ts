// What lies over the edit page, and where the pointer is.

import type { Area } from "./commands";
import type { Entry } from "./Menu.svelte";

class Page {
  palette = $state(false);
  menu = $state.raw<{ x: number; y: number; label: string; entries: Entry[] } | null>(null);
  area: Area = "";
  pointer = { x: 0, y: 0 };

  /** A menu where the pointer is. */
  ask(label: string, entries: Entry[]): void {
    this.menu = { ...this.pointer, label, entries };
  }
}

export const page = new Page();
