// Short texts and marks at points of the scene, as HTML, so that they stay sharp and can be read aloud and selected.

import { type Camera, Vector3 } from "three";

export interface Label {
  at: Vector3;
  text: string;
  /** Shown while the pointer is on it. */
  detail?: string;
  colour: string;
  /** Drawn at the point itself, with the text beside it; without one, the text is centred on the point. */
  symbol?: "disc" | "cross" | "ring";
}

const SYMBOLS = { disc: "●", cross: "✕", ring: "○" } as const;

export class Labels {
  private readonly layer = document.createElement("div");
  private shown: { at: Vector3; element: HTMLElement }[] = [];

  constructor(container: HTMLElement) {
    this.layer.className = "scene-labels";
    Object.assign(this.layer.style, {
      position: "absolute",
      inset: "0",
      overflow: "hidden",
      pointerEvents: "none",
      font: "11px/1 system-ui, sans-serif",
    });
    container.append(this.layer);
  }

  set(labels: readonly Label[]): void {
    this.shown = labels.map((label) => ({ at: label.at, element: drawn(label) }));
    this.layer.replaceChildren(...this.shown.map(({ element }) => element));
  }

  /** Moves all to where a camera sees them on a canvas of that size in CSS pixels. */
  update(camera: Camera, width: number, height: number): void {
    const place = new Vector3();
    for (const { at, element } of this.shown) {
      place.copy(at).project(camera);
      element.hidden = Math.abs(place.x) > 1 || Math.abs(place.y) > 1 || Math.abs(place.z) > 1;
      element.style.left = `${((place.x + 1) / 2) * width}px`;
      element.style.top = `${((1 - place.y) / 2) * height}px`;
    }
  }

  dispose(): void {
    this.layer.remove();
  }
}

const GROUND = { background: "#000b", borderRadius: "3px", padding: "1px 2px" };

function drawn({ text, detail, colour, symbol }: Label): HTMLElement {
  const element = document.createElement("div");
  Object.assign(element.style, { position: "absolute", transform: "translate(-50%, -50%)", whiteSpace: "nowrap", color: colour });
  if (detail) {
    element.title = detail;
    element.style.pointerEvents = "auto";
  }
  if (!symbol) {
    element.textContent = text;
    Object.assign(element.style, GROUND);
    return element;
  }
  const mark = document.createElement("span");
  mark.textContent = SYMBOLS[symbol];
  mark.ariaHidden = "true";
  Object.assign(mark.style, { fontSize: "13px", textShadow: "0 0 3px #000, 0 0 2px #000" });
  const beside = document.createElement("span");
  beside.textContent = text;
  Object.assign(beside.style, GROUND, { position: "absolute", left: "100%", top: "50%", transform: "translateY(-50%)", fontSize: "10px" });
  element.append(mark, beside);
  return element;
}
