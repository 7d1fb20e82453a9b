// Colours of the drawings: the page's own tokens, a quiet hue for each state, and one for each kind of transition.

export interface Colors {
  panel: string;
  raised: string;
  hover: string;
  line: string;
  strong: string;
  text: string;
  muted: string;
  faint: string;
  accent: string;
  soft: string;
  onAccent: string;
  sans: string;
  mono: string;
  dark: boolean;
  kinds: Record<string, string>;
}

export function readColors(element: Element): Colors {
  const style = getComputedStyle(element);
  const get = (name: string) => style.getPropertyValue(name).trim();
  const dark = document.documentElement.dataset.theme !== "light";
  return {
    panel: get("--panel"),
    raised: get("--raised"),
    hover: get("--hover"),
    line: get("--line"),
    strong: get("--line-strong"),
    text: get("--text"),
    muted: get("--muted"),
    faint: get("--faint"),
    accent: get("--accent"),
    soft: get("--accent-soft"),
    onAccent: get("--on-accent"),
    sans: get("--sans"),
    mono: get("--mono"),
    dark,
    kinds: {
      crossfade: dark ? "#5cc8ff" : "#0077b6",
      frozen: dark ? "#c9d6e8" : "#5b6b80",
      inertial: dark ? "#b9e651" : "#4f7f00",
      dead: dark ? "#ff7fa3" : "#c2255c",
    },
  };
}

const HUES = [235, 155, 310, 190, 15, 120, 275, 345];

/** A state's colour; machines begin at different hues so that their first states differ. */
export function stateColor(machine: number, state: number, dark: boolean, strength = 1): string {
  const hue = HUES[(state + 3 * machine) % HUES.length];
  return dark ? `oklch(${0.52 + 0.2 * strength} 0.095 ${hue})` : `oklch(${0.78 - 0.16 * strength} 0.1 ${hue})`;
}

/** A canvas of this size in sharp pixels, cleared; its units are CSS pixels. */
export function prepare(canvas: HTMLCanvasElement, width: number, height: number): CanvasRenderingContext2D {
  const ratio = Math.min(2, devicePixelRatio);
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = canvas.getContext("2d")!;
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return context;
}

const clipped = new Map<string, string>();

/** A text cut to a width, with an ellipsis; remembered, because measuring is slow. */
export function fitted(context: CanvasRenderingContext2D, text: string, width: number): string {
  const key = `${context.font}|${Math.round(width)}|${text}`;
  const known = clipped.get(key);
  if (known !== undefined) return known;
  let result = text;
  if (context.measureText(text).width > width) {
    let n = text.length;
    while (n > 1 && context.measureText(`${text.slice(0, n)}…`).width > width) n--;
    result = `${text.slice(0, n)}…`;
  }
  if (clipped.size > 4000) clipped.clear();
  clipped.set(key, result);
  return result;
}
