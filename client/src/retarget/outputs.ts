// Where a retargeted motion goes: files, the project of the edit page, a picture.

import { editor } from "../edit/editor.svelte";
import type { EditResult } from "../generated/messages";
import { save } from "../net/download";
import { studio } from "../studio.svelte";
import { retarget } from "./retarget.svelte";
import { stem } from "./subjects";

const why = (error: unknown) => (error instanceof Error ? error.message : String(error));

export async function saveAs(kind: string): Promise<void> {
  const { done } = retarget;
  if (!done || retarget.saving) return;
  retarget.saving = kind;
  try {
    save(await studio.connection.file(`api/retarget/${done.id}/${kind}`), `${stem(retarget.subjects.target!.name)}-${stem(done.name)}.${kind}`);
  } catch (error) {
    studio.toast("error", `It cannot be written as ${kind.toUpperCase()}`, why(error));
  } finally {
    retarget.saving = "";
  }
}

export async function sendToEdit(): Promise<void> {
  const { done } = retarget;
  if (!done || retarget.saving) return;
  retarget.saving = "edit";
  try {
    const result = await studio.connection.post<EditResult>(`api/retarget/${done.id}/edit`, new Blob([]));
    if (result.error) throw new Error(result.error);
    studio.turnTo("edit");
    activate(result.report);
  } catch (error) {
    studio.toast("error", "It was not added to the project", why(error));
  } finally {
    retarget.saving = "";
  }
}

/** The character that was sent is the one that is edited, as soon as it is there. */
function activate(character: string): void {
  const arrived = () => {
    const actor = editor.actorOf(character);
    if (!actor) return;
    studio.castListeners.delete(arrived);
    editor.activate(character);
    // it is framed where it begins, not where it stands at rest
    editor.perform();
    actor.measurePerformance();
    studio.view.pose();
    studio.view.frameAll("three-quarter", true);
  };
  studio.castListeners.add(arrived);
  arrived();
}

export async function savePicture(): Promise<void> {
  if (retarget.stages) save(await retarget.stages.screenshot(), `retarget-${stem(retarget.done?.name ?? "rest")}.png`);
}
