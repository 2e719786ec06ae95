// Short texts and marks at points of the scene, as HTML, so that they stay sharp and can be read aloud.

import { type Camera, Vector3 } from "three";

export interface Label {
  at: Vector3;
  text: string;
  /** Shown while the pointer is on it. */
  detail?: string;
  colour: string;
  /** Behind the text, where that is not nearly black. */
  ground?: string;
  /** Drawn at the point itself, with the text beside it; without one, the text is centred on the point. */
  symbol?: "disc" | "cross" | "ring";
}

const SYMBOLS = { disc: "●", cross: "✕", ring: "○" } as const;

/** A rectangle in CSS pixels: left, top, right, bottom. */
type Box = readonly [number, number, number, number];

interface Drawn {
  at: Vector3;
  element: HTMLElement;
  /** What may move beside the mark, or go; the element itself without a mark. */
  text: HTMLElement;
  size: { width: number; height: number };
  hasMark: boolean;
}

const MARK_PX = 7; // half the size of a mark

/** Labels of several owners in one layer, of which none overlaps another: the first come first, others move beside their marks or wait. */
export class Labels {
  private readonly layer = document.createElement("div");
  private readonly owners = new Map<string, Drawn[]>();

  /** canvas: gets what the pointer does on a label. */
  constructor(container: HTMLElement, canvas: HTMLElement) {
    this.layer.className = "scene-labels";
    Object.assign(this.layer.style, {
      position: "absolute",
      inset: "0",
      overflow: "hidden",
      pointerEvents: "none",
      userSelect: "none",
      font: "11px/1 system-ui, sans-serif",
    });
    for (const type of ["pointerdown", "pointermove", "wheel", "dblclick"]) {
      this.layer.addEventListener(type, (event) => {
        event.stopPropagation();
        canvas.dispatchEvent(new (event.constructor as typeof Event)(type, event));
      });
    }
    container.append(this.layer);
  }

  set(owner: string, labels: readonly Label[]): void {
    if (!labels.length && !this.owners.get(owner)?.length) return;
    this.owners.set(owner, labels.map(drawn));
    this.layer.replaceChildren(...this.all.map(({ element }) => element));
  }

  /** Moves all to where a camera sees them on a canvas of that size in CSS pixels. corner: right and upper border of what lies in its lower left one. */
  update(camera: Camera, width: number, height: number, corner: { right: number; top: number } | null): void {
    const taken: Box[] = corner ? [[0, corner.top, corner.right, height]] : [];
    const place = new Vector3();
    const seen = this.all.flatMap((label) => {
      place.copy(label.at).project(camera);
      const isSeen = Math.abs(place.x) <= 1 && Math.abs(place.y) <= 1 && Math.abs(place.z) <= 1;
      label.element.hidden = !isSeen;
      return isSeen ? [{ ...label, x: ((place.x + 1) / 2) * width, y: ((1 - place.y) / 2) * height }] : [];
    });
    for (const { x, y, element, hasMark } of seen) {
      Object.assign(element.style, { left: `${x}px`, top: `${y}px` });
      if (hasMark) taken.push([x - MARK_PX, y - MARK_PX, x + MARK_PX, y + MARK_PX]);
    }
    for (const { x, y, text, size, hasMark } of seen) {
      if (!size.width) Object.assign(size, { width: text.offsetWidth, height: text.offsetHeight });
      const found = places(size, hasMark).find(([dx, dy]) => {
        const box = boxAt(x + dx, y + dy, size);
        return box[0] >= 0 && box[1] >= 0 && box[2] <= width && box[3] <= height && !taken.some((other) => overlap(box, other));
      });
      text.style.visibility = found ? "visible" : "hidden";
      if (!found) continue;
      taken.push(boxAt(x + found[0], y + found[1], size));
      text.style.translate = `${found[0]}px ${found[1]}px`;
    }
  }

  dispose(): void {
    this.layer.remove();
  }

  private get all(): Drawn[] {
    return [...this.owners.values()].flat();
  }
}

/** Where the middle of a text may be, from its point. */
function places({ width, height }: Drawn["size"], hasMark: boolean): readonly (readonly [number, number])[] {
  if (!hasMark) return [[0, 0]];
  const [aside, off] = [MARK_PX + width / 2, MARK_PX + height / 2];
  return [
    [aside, 0],
    [-aside, 0],
    [0, -off],
    [0, off],
    [aside, -off],
    [-aside, -off],
    [aside, off],
    [-aside, off],
  ];
}

function boxAt(x: number, y: number, { width, height }: Drawn["size"]): Box {
  return [x - width / 2, y - height / 2, x + width / 2, y + height / 2];
}

function overlap(a: Box, b: Box): boolean {
  return a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3];
}

const GROUND = { background: "#000b", borderRadius: "3px", padding: "1px 2px" };
const CENTRED = { position: "absolute", transform: "translate(-50%, -50%)", whiteSpace: "nowrap" };

function drawn({ at, text, detail, colour, ground, symbol }: Label): Drawn {
  const element = document.createElement("div");
  const words = document.createElement("span");
  Object.assign(element.style, { position: "absolute", color: colour });
  words.textContent = text;
  Object.assign(words.style, CENTRED, GROUND, symbol ? { fontSize: "10px" } : {}, ground ? { background: ground } : {});
  if (symbol) {
    const mark = document.createElement("span");
    mark.textContent = SYMBOLS[symbol];
    mark.ariaHidden = "true";
    Object.assign(mark.style, CENTRED, { fontSize: "13px", textShadow: "0 0 3px #000, 0 0 2px #000" });
    element.append(mark);
  }
  element.append(words);
  if (detail) {
    element.title = detail;
    element.style.pointerEvents = "auto";
  }
  return { at, element, text: words, size: { width: 0, height: 0 }, hasMark: symbol !== undefined };
}
