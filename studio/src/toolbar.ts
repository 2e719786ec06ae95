// What is run, and how: scenario, comparison, keys, play, speed, the slider over steps, and who steers.

import { chooser } from "./chooser.ts";
import { h, ICONS, icon, relabel, select, signButton, toggle } from "./dom.ts";
import { history } from "./model/history.ts";
import type { ChoicesMessage, Named, Run, ScenarioMessage } from "./protocol.ts";
import type { Session } from "./session.ts";
import { hasPen, needsPen, newestStep, type State, type Studio } from "./state.ts";
import { words } from "./words.ts";

const SPEEDS = [
  ["", "as fast as it goes"],
  ["0.1", "0.1 x real time"],
  ["0.25", "0.25 x real time"],
  ["0.5", "0.5 x real time"],
  ["1", "1 x real time"],
] as const;
const NOTHING = "no comparison";

/** What the keyboard does as well, and its element. */
export type Toolbar = Record<"playOrPause" | "step" | "reset" | "undo" | "redo" | "save", () => void> & { element: HTMLElement };

export function toolbar(store: Studio, session: Session, opens: Record<"help" | "summary" | "keys", () => void>): Toolbar {
  const goOn = (type: "play" | "pause" | "step") => {
    if (!hasPen(store.state)) return;
    if (store.state.scrub !== null) session.scrub(null);
    session.send({ type });
  };
  const playOrPause = () => goOn(store.state.status?.playing ? "pause" : "play");
  const step = () => goOn("step");
  const reset = () => session.steer({ type: "reset" });
  const edits = history(store, session);
  const keys = toggle("Keys", "Controls of all keys of the scenario (k)", opens.keys);
  store.on(["keys_open"], ({ keys_open }) => keys.show(keys_open));

  const element = h(
    "div",
    { class: "toolbar", role: "group", "aria-label": "Run" },
    h(
      "div",
      { class: "row" },
      h("h1", {}, "luxloop ", h("span", {}, "studio")),
      ...scenarioControls(store, session),
      ...keyControls(store, session),
      h("span", { class: "spacer" }),
      ...people(store, session),
      keys.button,
      button("Summary", "The summary of the run so far", opens.summary),
      button("?", "Keyboard shortcuts (?)", opens.help, "square"),
    ),
    h(
      "div",
      { class: "row" },
      ...playControls(store, session, { playOrPause, step, reset }),
      ...edits.elements,
      ...timeControls(store, session),
    ),
  );
  return { element, playOrPause, step, reset, ...edits };
}

function button(text: string, title: string, onclick: () => void, style = ""): HTMLButtonElement {
  return h("button", { class: style, title, "aria-label": text.length > 1 ? null : title, onclick }, text);
}

function scenarioControls(store: Studio, session: Session): HTMLElement[] {
  const isRecording = (choice: string) => store.state.choices?.recordings.some(({ name }) => name === choice) ?? false;
  const scenarios = chooser("Scenario", (choice) => {
    const [name, recording] = isRecording(choice) ? ["", choice] : [choice, null];
    session.send({ type: "open", name, overrides: [], recording });
  });
  const compared = chooser("Compare with", (name) => {
    const scenario = store.state.scenario;
    if (isRecording(name)) session.send({ type: "compare", overrides: null, recording: name });
    else if (scenario) session.send({ type: "compare", overrides: name === NOTHING ? null : comparison(scenario.runs[0], name) });
  });
  store.on(["scenario", "choices"], ({ scenario, choices }) => {
    scenarios.show([...(choices?.scenarios ?? []), ...(choices?.recordings ?? [])], scenario?.runs[0].label ?? "choose a scenario");
    compared.show(
      comparisons(scenario, choices),
      scenario?.runs[1] ? `with ${scenario.runs[1].label.replaceAll(/functions\.\S+\.controller=/g, "")}` : "compare with ...",
    );
  });
  needsPen(store, scenarios, compared);
  compared.element.classList.add("compare");
  return [scenarios.element, compared.element];
}

/** What a second run can be: with another controller of one function each, or of all together, or a recording. */
function comparisons(scenario: ScenarioMessage | null, choices: ChoicesMessage | null): Named[] {
  if (!scenario || !choices) return [];
  const none = { name: NOTHING, description: "One run alone." };
  const functions = Object.keys(scenario.runs[0].controllers);
  if (functions.length === 0)
    return [
      none,
      { name: "", description: "No function of this scenario has a controller; compare keys instead (Shift+Enter)." },
      ...choices.recordings,
    ];
  const of = functions.length > 1 ? functions.map((name) => `${name}: `) : [""];
  return [
    none,
    ...of.flatMap((name) => choices.controllers.map((each) => ({ name: `${name}${each.name}`, description: each.description }))),
    ...choices.recordings,
  ];
}

function comparison(run: Run, choice: string): string[] | null {
  const [controller, only] = choice.split(": ").reverse();
  if (!controller) return null;
  const functions = Object.keys(run.controllers).filter((name) => only === undefined || name === only);
  return functions.map((name) => `functions.${name}.controller=${controller}`);
}

function keyControls(store: Studio, session: Session): HTMLElement[] {
  const seed = h("input", { type: "number", min: 0, step: 1, "aria-label": "Seed of all noise", class: "seed" });
  seed.addEventListener("change", () => {
    if (Number.isInteger(seed.valueAsNumber) && seed.valueAsNumber >= 0) session.edit([`seed=${seed.value}`]);
    else seed.value = String(store.state.scenario?.seed ?? 0);
  });
  const keys = h("input", {
    type: "text",
    class: "keys",
    placeholder: "road.kind=bumps camera.bits=10",
    "aria-label": "Other values of keys; Enter sets them, Shift+Enter compares",
    title:
      "Other values of keys. Enter sets them; the badges in the drawer of keys say when they act. Shift+Enter compares with a run that has them.",
    spellcheck: "false",
    autocomplete: "off",
  });
  keys.addEventListener("keydown", (event) => {
    if (event.key !== "Enter") return;
    const overrides = words(keys.value);
    if (overrides.length === 0) return;
    if (event.shiftKey) session.send({ type: "compare", overrides });
    else session.edit(overrides, true);
  });
  keys.addEventListener("input", () => keys.removeAttribute("aria-invalid"));
  let source = "";
  store.on(["scenario"], ({ scenario }) => {
    if (!scenario) return;
    seed.value = String(scenario.seed);
    if (scenario.source !== source) keys.value = ""; // typed for another scenario
    source = scenario.source;
    keys.removeAttribute("aria-invalid");
  });
  store.on(["model"], () => keys.removeAttribute("aria-invalid"));
  store.on(["refused"], ({ refused }) => {
    if (refused) seed.value = String(store.state.scenario?.seed ?? 0);
    if (refused?.overrides.join() === words(keys.value).join()) keys.setAttribute("aria-invalid", "true");
  });
  needsPen(store, seed, keys);
  return [h("label", {}, "seed ", seed), h("label", { class: "grows" }, "keys ", keys)];
}

function people(store: Studio, session: Session): HTMLElement[] {
  const text = h("span", { class: "muted" });
  const pen = button("Take the pen", "Steer the runs from this page", () => session.send({ type: "pen" }), "accent");
  store.on(["link", "status", "role", "id"], (state) => {
    text.textContent = audience(state);
    pen.hidden = state.role !== "edit" || state.link !== "open" || state.status === null || hasPen(state);
  });
  return [text, pen];
}

function audience(state: Readonly<State>): string {
  const { status, role, link } = state;
  if (link !== "open" || !status) return "";
  const pages = status.clients > 1 ? `, ${status.clients} pages are open` : "";
  if (role === "watch") return `You watch${pages}`;
  return `${hasPen(state) ? "You have the pen" : status.pen === null ? "Nobody has the pen" : "Another page has the pen"}${pages}`;
}

function playControls(
  store: Studio,
  session: Session,
  does: { playOrPause: () => void; step: () => void; reset: () => void },
): (HTMLButtonElement | HTMLSelectElement)[] {
  const signs = { play: icon(ICONS.play), pause: icon(ICONS.pause) };
  const play = h("button", { class: "accent square", onclick: does.playOrPause }, signs.play);
  const step = signButton("step", "One step (.)", does.step, "square");
  const reset = signButton("reset", "Start anew (r)", does.reset, "square");
  const speed = select("Speed", SPEEDS, (value) => session.send({ type: "speed", factor: value === "" ? null : Number(value) }));
  let playing: boolean | null = null;
  store.on(["status"], ({ status }) => {
    const now = status?.playing ?? false;
    if (now !== playing) {
      playing = now;
      play.replaceChildren(now ? signs.pause : signs.play);
      relabel(play, now ? "Pause (space)" : "Play (space)");
    }
    if (status && document.activeElement !== speed) {
      const value = status.speed === null ? "" : String(status.speed);
      if (![...speed.options].some((each) => each.value === value)) speed.append(h("option", { value }, `${value} x real time`));
      speed.value = value;
    }
  });
  needsPen(store, play, step, reset, speed);
  return [play, step, reset, speed];
}

function timeControls(store: Studio, session: Session): HTMLElement[] {
  const slider = h("input", { type: "range", min: 0, max: 0, step: 1, value: 0, class: "scrub", "aria-label": "Step to look at again" });
  slider.addEventListener("input", () => session.scrub(slider.valueAsNumber));
  const follow = button("live", "Follow the newest step again", () => session.scrub(null), "toggle");
  const counter = h("output", { class: "counter" });
  const pace = h("output", { class: "counter pace muted" });
  store.on(["step_version", "rows_version", "scenario", "scrub", "status"], (state) => {
    const { scenario, scrub, status } = state;
    const newest = newestStep(state);
    const live = Math.max(-1, ...state.runs.map((run) => run.newest));
    const shown = scrub ?? live;
    slider.max = String(Math.max(0, newest));
    slider.disabled = newest < 1;
    if (scrub === null) slider.value = String(Math.max(0, live));
    follow.setAttribute("aria-pressed", String(scrub === null));
    counter.textContent =
      scenario && shown >= 0 ? `step ${shown} of ${Math.max(scenario.steps, live + 1)}, ${(shown / scenario.rate_hz).toFixed(2)} s` : "";
    slider.setAttribute("aria-valuetext", counter.textContent);
    pace.textContent = [
      status?.real_time != null ? `${significant(status.real_time)} x real time` : "",
      status?.step_ms != null ? `${status.step_ms.toFixed(0)} ms a step` : "",
    ]
      .filter(Boolean)
      .join(", ");
  });
  return [slider, follow, counter, pace];
}

function significant(value: number): string {
  return value >= 100 ? value.toFixed(0) : value.toPrecision(2);
}
