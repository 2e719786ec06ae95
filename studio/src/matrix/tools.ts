// The strip of tools with which pixels are painted.

import { download, fill, h, numberField, numberOf, select, toggle } from "../dom.ts";
import { needsPen, type Studio } from "../state.ts";
import { csv, png, readPixels } from "./files.ts";
import { type Painting, TOOLS, type Tool } from "./painting.ts";

const TITLES: Record<Tool, string> = {
  brush: "Paint pixels; the right mouse button moves the picture",
  eraser: "Rub out what is painted",
  line: "Draw a straight line",
  fill: "Fill a region of pixels that are painted alike",
  text: "Write a text; its lower left corner is where you click",
};

export interface Tools {
  element: HTMLElement;
  refresh(): void;
  /** Let the user say which text is written. */
  askText(): void;
}

/** shown: utilisation 0..255 of all pixels of a module as it is shown. does: what else the buttons do. */
export function paintTools(
  store: Studio,
  painting: Painting,
  shown: (module: number) => Uint8Array | null,
  does: { clear: () => void; toast: (sentence: string) => void },
): Tools {
  const names = () => store.state.scenario?.runs[0].modules.map(({ name }) => name) ?? [];
  const choose = (tool: Tool) => {
    painting.tool = tool;
    refresh();
  };
  const buttons = TOOLS.map((tool) => ({ tool, ...toggle(tool, TITLES[tool], () => choose(tool)) }));
  const thickness = numberField("Thickness in pixels; of text, its height", {
    min: 1,
    max: 200,
    step: 1,
    onchange: () => {
      painting.thickness = Math.round(numberOf(thickness, 1));
      refresh();
    },
  });
  const value = numberField("Utilisation that is painted, in per cent", {
    min: 0,
    max: 100,
    step: 5,
    onchange: () => {
      painting.value = Math.round(2.55 * numberOf(value));
      refresh();
    },
  });
  const words = h("input", {
    type: "text",
    class: "words",
    placeholder: "text",
    "aria-label": "Text that is written",
    oninput: () => (painting.words = words.value),
  });
  const over = select(
    "Whether what is painted lies over the light of the functions, or is shown in its place",
    [
      ["over", "over functions"],
      ["instead", "instead of them"],
    ],
    (choice) => painting.setOver(choice === "over"),
  );
  const module = select("The module of files", [], (choice) => {
    painting.module = Number(choice);
  });
  const button = (text: string, title: string, onclick: () => void) => h("button", { title, onclick }, text);
  const file = h("input", { type: "file", accept: ".png,.csv", hidden: true, "aria-label": "A picture of a module's pixels" });
  file.addEventListener("change", async () => {
    const [picture] = file.files ?? [];
    file.value = "";
    if (!picture) return;
    try {
      const pixels = await readPixels(picture);
      painting.take(painting.module, names()[painting.module], pixels, picture.name);
    } catch (error) {
      does.toast(error instanceof Error ? error.message : String(error));
    }
  });
  const saved = async (kind: "png" | "csv") => {
    const u = shown(painting.module);
    const cols = painting.layers[painting.module]?.cols;
    if (!u || !cols) return;
    const content = kind === "png" ? await png(u, cols) : new Blob([csv(u, cols)], { type: "text/csv" });
    download(`${names()[painting.module].replaceAll(" ", "_")}.${kind}`, content);
  };
  const element = h(
    "div",
    { class: "bar paint-tools", role: "toolbar", "aria-label": "Painting" },
    h("div", { class: "segments" }, ...buttons.map((each) => each.button)),
    h("label", { title: thickness.title }, "px", thickness),
    h("label", { title: value.title }, "%", value),
    words,
    over,
    button("clear", "Rub out all that is painted, in all modules", does.clear),
    module,
    button("import", "Paint a PNG or CSV of this module's size", () => file.click()),
    button("PNG", "Save the module's pixels as they are shown, as PNG", () => void saved("png")),
    button("CSV", "Save the module's pixels as they are shown, as CSV", () => void saved("csv")),
    file,
  );
  const refresh = () => {
    for (const { tool, show } of buttons) show(tool === painting.tool);
    thickness.value = String(painting.thickness);
    value.value = String(Math.round(painting.value / 2.55));
    words.hidden = painting.tool !== "text";
    over.value = painting.over ? "over" : "instead";
    module.value = String(painting.module);
  };
  store.on(["scenario"], () => {
    fill(
      module,
      names().map((name, k) => [String(k), name]),
    );
    refresh();
  });
  needsPen(store, ...element.querySelectorAll<HTMLButtonElement>("button, select, input"));
  return { element, refresh, askText: () => setTimeout(() => words.focus()) }; // after the click, which takes the focus
}
