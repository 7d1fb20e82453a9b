// Files that were dropped or chosen, folders included.

import type { Blobs } from "./net/container";

const SKIPPED = /(^|\/)(\.|__MACOSX|Thumbs\.db)/;
const MOST = 2000;

async function* walk(entry: FileSystemEntry, prefix: string): AsyncGenerator<[string, File]> {
  if (entry.isFile) {
    const file = await new Promise<File>((resolve, reject) => (entry as FileSystemFileEntry).file(resolve, reject));
    yield [prefix + entry.name, file];
    return;
  }
  const reader = (entry as FileSystemDirectoryEntry).createReader();
  for (;;) {
    const entries = await new Promise<FileSystemEntry[]>((resolve, reject) => reader.readEntries(resolve, reject));
    if (entries.length === 0) return;
    for (const child of entries) yield* walk(child, `${prefix}${entry.name}/`);
  }
}

async function read(named: [string, File][]): Promise<Blobs[]> {
  const kept = named.filter(([name]) => !SKIPPED.test(name)).slice(0, MOST);
  return Promise.all(kept.map(async ([name, file]) => ({ name, data: await file.arrayBuffer() })));
}

export async function droppedFiles(transfer: DataTransfer): Promise<Blobs[]> {
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry?.() ?? null);
  const files = [...transfer.files];
  const named: [string, File][] = [];
  if (entries.some((entry) => entry?.isDirectory)) {
    for (const entry of entries) if (entry) for await (const found of walk(entry, "")) named.push(found);
  } else named.push(...files.map((file): [string, File] => [file.name, file]));
  return read(named);
}

/** Let the user choose files. */
export function chooseFiles(use: (files: Blobs[]) => void): void {
  const input = document.createElement("input");
  input.type = "file";
  input.multiple = true;
  input.onchange = () => void read([...(input.files ?? [])].map((file): [string, File] => [file.name, file])).then(use);
  input.click();
}
