// What the editor asks of the server. The server's document is the one that counts.

import type { Changes } from "./contract";

export interface Scope {
  readonly clip: string;
  readonly character: string;
  /** Channel key -> indices of keys, or null for all of them; no channels means all of the clip. */
  readonly channels: ReadonlyMap<string, Uint32Array | null>;
  /** First and last second of the clip that are worked on; null for all of it. */
  readonly span: readonly [number, number] | null;
}

export type Values = Readonly<Record<string, string | number | boolean | number[]>>;

export interface Link {
  /** Resolves with the revision that holds the changes; rejects where they are refused. */
  commit(id: string, label: string, changes: Changes): Promise<number>;
  operate(name: string, scope: Scope, parameters: Values): Promise<void>;
  undo(): Promise<void>;
  redo(): Promise<void>;
}
