// Marks over the camera's picture: what is tracked, masked, found, lit and aimed at.

import type { Mark } from "../protocol.ts";

/** Colours that are told apart without red and green (Okabe and Ito), and a dash of their own. */
export const MARKS: Record<Mark["kind"], { colour: string; dash: number[]; text: string }> = {
  tracked: { colour: "#56b4e9", dash: [], text: "tracked" },
  masked: { colour: "#e69f00", dash: [], text: "masked" },
  found: { colour: "#f0e442", dash: [2, 3], text: "found" },
  zone: { colour: "#cc79a7", dash: [], text: "zone" },
  target: { colour: "#ffffff", dash: [6, 4], text: "target" },
};

const LINE_PX = 13; // from one text to the next above

/** Draw marks in pixels of the camera; `scale` is CSS pixels a pixel. */
export function drawMarks(context: CanvasRenderingContext2D, marks: readonly Mark[], scale: number): void {
  const px = 1 / scale;
  context.lineJoin = "round";
  for (const { lines, kind } of marks) {
    const path = new Path2D();
    for (const [[u, v], [u2, v2]] of lines) {
      path.moveTo(u, v);
      path.lineTo(u2, v2);
    }
    const { colour, dash } = MARKS[kind] ?? MARKS.found;
    context.setLineDash([]);
    context.strokeStyle = "#000a";
    context.lineWidth = 3.5 * px;
    context.stroke(path);
    context.setLineDash(dash.map((each) => each * px));
    context.strokeStyle = colour;
    context.lineWidth = 1.5 * px;
    context.stroke(path);
  }
  context.setLineDash([]);
  context.font = `${12 * px}px system-ui, sans-serif`;
  context.textBaseline = "bottom";
  const line = LINE_PX * px;
  const taken: { u: number; v: number; end: number }[] = [];
  for (const { text, at, kind } of marks) {
    if (!text) continue;
    const place = { u: at[0], v: at[1], end: at[0] + context.measureText(text).width };
    const isTaken = () => taken.some(({ u, v, end }) => Math.abs(v - place.v) < line && u < place.end && place.u < end);
    while (isTaken()) place.v -= line;
    taken.push(place);
    context.strokeStyle = "#000c";
    context.lineWidth = 3 * px;
    context.strokeText(text, place.u, place.v);
    context.fillStyle = (MARKS[kind] ?? MARKS.found).colour;
    context.fillText(text, place.u, place.v);
  }
}
