// The false colours' scale, over the canvas.

import { DECADES, GRADIENT, ISOLUX_LX, share } from "./colour_map.ts";

export class Legend {
  private readonly element = document.createElement("div");

  constructor(container: HTMLElement) {
    const { element } = this;
    element.className = "scene-legend";
    element.hidden = true;
    Object.assign(element.style, {
      position: "absolute",
      left: "12px",
      bottom: "12px",
      width: "min(280px, 60%)",
      padding: "6px 20px 4px 14px",
      borderRadius: "4px",
      background: "rgba(10, 12, 16, 0.72)",
      color: "#e8eaee",
      font: "11px/1.3 system-ui, sans-serif",
      fontVariantNumeric: "tabular-nums",
      pointerEvents: "none",
    });
    const bar = document.createElement("div");
    Object.assign(bar.style, { height: "10px", background: GRADIENT });
    const numbers = document.createElement("div");
    Object.assign(numbers.style, { position: "relative", height: "15px" });
    for (let decade = DECADES[0]; decade <= DECADES[1]; decade++) {
      numbers.append(tick(10 ** decade, decade === DECADES[1] ? `${10 ** decade} lx` : `${10 ** decade}`));
    }
    element.append("Illuminance by the lamps", bar, numbers);
    for (const lx of ISOLUX_LX) bar.append(mark(lx));
    bar.style.position = "relative";
    container.append(element);
  }

  show(visible: boolean, isolux: boolean): void {
    this.element.hidden = !visible;
    for (const line of this.element.querySelectorAll<HTMLElement>("[data-isolux]")) line.hidden = !isolux;
  }

  /** Its right and upper border in CSS pixels of the canvas, in whose lower left corner it is; null where it is hidden. */
  get corner(): { right: number; top: number } | null {
    const { hidden, offsetLeft, offsetWidth, offsetTop } = this.element;
    return hidden ? null : { right: offsetLeft + offsetWidth, top: offsetTop };
  }

  dispose(): void {
    this.element.remove();
  }
}

function tick(lx: number, text: string): HTMLElement {
  const element = document.createElement("span");
  element.textContent = text;
  Object.assign(element.style, { position: "absolute", left: `${100 * share(lx)}%`, transform: "translateX(-50%)", whiteSpace: "nowrap" });
  return element;
}

function mark(lx: number): HTMLElement {
  const element = document.createElement("span");
  element.dataset.isolux = `${lx}`;
  Object.assign(element.style, {
    position: "absolute",
    left: `${100 * share(lx)}%`,
    top: "0",
    width: "1px",
    height: "100%",
    background: "#fff",
  });
  return element;
}
