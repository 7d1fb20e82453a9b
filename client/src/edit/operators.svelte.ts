// Operators of the server: what they ask for, and what was typed into their forms.

import type { OperatorParameter, OperatorSpec } from "../generated/messages";
import { studio } from "../studio.svelte";

export type Value = number | boolean | string;

class Operators {
  known = $state.raw<readonly OperatorSpec[]>([]);
  active = $state("");
  /** Operator -> parameter -> value, where it was changed. */
  values = $state<Record<string, Record<string, Value>>>({});
  private asked = false;

  async load(): Promise<void> {
    if (this.asked) return;
    this.asked = true;
    try {
      this.known = await studio.connection.json<OperatorSpec[]>("api/project/operators");
      this.active ||= this.known[0]?.name ?? "";
    } catch (error) {
      this.asked = false;
      studio.toast("error", "The operators are not known", error instanceof Error ? error.message : String(error));
    }
  }

  value(operator: OperatorSpec, parameter: OperatorParameter): Value {
    return this.values[operator.name]?.[parameter.name] ?? parameter.default;
  }

  set(operator: OperatorSpec, parameter: OperatorParameter, value: Value): void {
    (this.values[operator.name] ??= {})[parameter.name] = value;
  }

  parameters(operator: OperatorSpec): Record<string, Value> {
    return Object.fromEntries(operator.parameters.map((p) => [p.name, this.value(operator, p)]));
  }
}

export const operators = new Operators();
