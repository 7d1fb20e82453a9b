// The selected time: a stretch of the timeline that operators keep to.

import type { Editor } from "./contract";

type Holder = Pick<Editor, "span" | "timeline">;

/** From this moment on: up to where the selected time ends, else to the end of the range. */
export function selectFrom(editor: Holder, time: number): void {
  const end = editor.span?.[1] ?? editor.timeline?.end ?? time;
  set(editor, time, time < end ? end : (editor.timeline?.end ?? time));
}

/** Up to this moment: from where the selected time begins, else from the start of the range. */
export function selectTo(editor: Holder, time: number): void {
  const start = editor.span?.[0] ?? editor.timeline?.start ?? time;
  set(editor, start < time ? start : (editor.timeline?.start ?? time), time);
}

function set(editor: Holder, start: number, end: number): void {
  editor.span = end > start ? [start, end] : null;
}
