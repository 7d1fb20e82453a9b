// What the play page can show. A tab is mounted when it is first seen and then stays; `active` says whether it is seen now.

import type { Component } from "svelte";
import Crowd from "../crowd/Crowd.svelte";
import Character from "./Character.svelte";

export interface Tab {
  id: string;
  label: string;
  component: Component<{ active: boolean; onopen: () => void }>;
}

export const TABS: Tab[] = [
  { id: "character", label: "Character", component: Character },
  { id: "crowd", label: "Crowd", component: Crowd },
];
