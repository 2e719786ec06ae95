// A canvas whose content is zoomed by the wheel and dragged; a double click, or 0, shows all of it.

import { h, onceAFrame } from "./dom.ts";

const WHEEL = 0.0016; // of a pixel of the wheel, as a natural logarithm of scale
const KEY_PX = 40;

export interface Point {
  x: number;
  y: number;
}

export class Viewport {
  readonly canvas = h("canvas", { tabindex: 0 });
  readonly redraw: () => void;
  /** A double click is two strokes where strokes are drawn. */
  doubleClickFits = true;
  #content = { width: 1, height: 1 };
  /** CSS pixels a unit of content, and where its corner lies; null shows all of it. */
  #view: { scale: number; x: number; y: number } | null = null;
  #drag: Point | null = null;
  #stroke = false;
  readonly #context: CanvasRenderingContext2D;

  /**
   * on.draw: draw, in units of content; `scale` is screen pixels a unit. on.hover: the point below the cursor, null outside. on.press: the main
   * button goes down; where it returns true, all points up to `release` are those of a stroke, and nothing moves.
   */
  constructor(
    label: string,
    private readonly on: {
      draw: (context: CanvasRenderingContext2D, scale: number) => void;
      hover: (point: Point | null) => void;
      press?: (point: Point) => boolean;
      stroke?: (point: Point) => void;
      release?: () => void;
    },
    private readonly largestScale = 64,
  ) {
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", `${label}. Wheel or + and - zoom, dragging or arrow keys move, 0 shows all.`);
    this.#context = this.canvas.getContext("2d") as CanvasRenderingContext2D;
    this.redraw = onceAFrame(() => this.#draw());
    new ResizeObserver(this.redraw).observe(this.canvas);
    this.#listen();
  }

  /** Size of the content in its units. */
  setContent(width: number, height: number): void {
    if (width === this.#content.width && height === this.#content.height) return;
    this.#content = { width, height };
    this.#view = null;
    this.redraw();
  }

  /** Show all of the content. */
  fit(): void {
    this.#view = null;
    this.redraw();
  }

  /** Unit of content below a point of the canvas in CSS pixels. */
  at(x: number, y: number): { x: number; y: number } {
    const view = this.#shown();
    return { x: (x - view.x) / view.scale, y: (y - view.y) / view.scale };
  }

  /** Point of the canvas in CSS pixels where a unit of content is. */
  of(x: number, y: number): [number, number] {
    const view = this.#shown();
    return [view.x + view.scale * x, view.y + view.scale * y];
  }

  #shown(): { scale: number; x: number; y: number } {
    if (this.#view) return this.#view;
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const scale = Math.min(width / this.#content.width, height / this.#content.height) || 1;
    return { scale, x: (width - scale * this.#content.width) / 2, y: (height - scale * this.#content.height) / 2 };
  }

  #zoom(factor: number, x: number, y: number): void {
    const old = this.#shown();
    const all = Math.min(this.canvas.clientWidth / this.#content.width, this.canvas.clientHeight / this.#content.height);
    const scale = Math.min(Math.max(old.scale * factor, all), Math.max(this.largestScale, all));
    const share = scale / old.scale;
    this.#view = scale <= all ? null : { scale, x: x - share * (x - old.x), y: y - share * (y - old.y) };
    this.redraw();
  }

  #move(x: number, y: number): void {
    if (!this.#view) return;
    const { scale } = this.#view;
    const keep = (at: number, size: number, room: number) => Math.min(room / 2, Math.max(room / 2 - scale * size, at));
    this.#view = {
      scale,
      x: keep(this.#view.x + x, this.#content.width, this.canvas.clientWidth),
      y: keep(this.#view.y + y, this.#content.height, this.canvas.clientHeight),
    };
    this.redraw();
  }

  #listen(): void {
    const { canvas } = this;
    canvas.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        const px = event.deltaMode === WheelEvent.DOM_DELTA_PIXEL ? event.deltaY : 32 * event.deltaY;
        this.#zoom(Math.exp(-WHEEL * px), event.offsetX, event.offsetY);
        this.on.hover(this.at(event.offsetX, event.offsetY));
      },
      { passive: false },
    );
    canvas.addEventListener("pointerdown", (event) => {
      if (document.activeElement instanceof HTMLInputElement) document.activeElement.blur(); // which takes what was typed
      canvas.setPointerCapture(event.pointerId);
      this.#stroke = event.button === 0 && (this.on.press?.(this.at(event.offsetX, event.offsetY)) ?? false);
      if (!this.#stroke) this.#drag = { x: event.offsetX, y: event.offsetY };
    });
    canvas.addEventListener("pointermove", (event) => {
      if (this.#stroke) {
        const { left, top } = canvas.getBoundingClientRect();
        for (const { clientX, clientY } of event.getCoalescedEvents()) this.on.stroke?.(this.at(clientX - left, clientY - top));
        this.on.stroke?.(this.at(event.offsetX, event.offsetY));
      } else if (this.#drag) {
        this.#move(event.offsetX - this.#drag.x, event.offsetY - this.#drag.y);
        this.#drag = { x: event.offsetX, y: event.offsetY };
      }
      this.on.hover(this.at(event.offsetX, event.offsetY));
    });
    for (const end of ["pointerup", "pointercancel"] as const) {
      canvas.addEventListener(end, () => {
        if (this.#stroke) this.on.release?.();
        this.#stroke = false;
        this.#drag = null;
      });
    }
    canvas.addEventListener("pointerleave", () => this.on.hover(null));
    canvas.addEventListener("contextmenu", (event) => this.on.press && event.preventDefault());
    canvas.addEventListener("dblclick", () => this.doubleClickFits && this.fit());
    canvas.addEventListener("keydown", (event) => {
      const { clientWidth: width, clientHeight: height } = canvas;
      const keys: Record<string, () => void> = {
        "+": () => this.#zoom(1.5, width / 2, height / 2),
        "-": () => this.#zoom(1 / 1.5, width / 2, height / 2),
        "0": () => this.fit(),
        ArrowLeft: () => this.#move(KEY_PX, 0),
        ArrowRight: () => this.#move(-KEY_PX, 0),
        ArrowUp: () => this.#move(0, KEY_PX),
        ArrowDown: () => this.#move(0, -KEY_PX),
      };
      const act = keys[event.key];
      if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      act();
    });
  }

  #draw(): void {
    const { canvas } = this;
    const ratio = window.devicePixelRatio || 1;
    const width = Math.round(canvas.clientWidth * ratio);
    const height = Math.round(canvas.clientHeight * ratio);
    if (width === 0 || height === 0) return;
    if (canvas.width !== width || canvas.height !== height) {
      canvas.width = width;
      canvas.height = height;
    }
    const { scale, x, y } = this.#shown();
    const context = this.#context;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, width, height);
    context.setTransform(ratio * scale, 0, 0, ratio * scale, ratio * x, ratio * y);
    context.imageSmoothingEnabled = ratio * scale < 1;
    context.imageSmoothingQuality = "medium";
    this.on.draw(context, scale);
  }
}
