// The curve views alone, with a document of its own. In the address: ?scene=few|dense|rotations&theme=light&markers=0

import { mount } from "svelte";
import "../src/app.css";
import { commandFor } from "../src/edit/commands";
import { FakeEditor } from "./fake-editor.svelte";
import Page from "./Page.svelte";
import { scenes } from "./scenes";

const asked = new URLSearchParams(location.search);
document.documentElement.dataset.theme = asked.get("theme") ?? "dark";
const editor = new FakeEditor(scenes[asked.get("scene") ?? "few"](asked.get("markers") !== "0"));
mount(Page, { target: document.getElementById("app")!, props: { editor } });

addEventListener("keydown", (event) => {
  if (event.target instanceof HTMLInputElement) return;
  if (event.ctrlKey && event.key === "z") return editor.undo();
  const command = commandFor(event, "blender", "curves");
  if (!command) return;
  event.preventDefault();
  command.run(event);
});
Object.assign(window, { harness: { editor } });
