// Texts whose contrast with what is behind them is below 4.5 (WCAG 2.1, 1.4.3), and controls without a name for a screen reader.
// Behind what lies on a picture there may be black or white.
const LEAST = 4.5;
const parsed = (colour) => {
  const [r, g, b, a = 1] = colour.match(/[\d.]+/g).map(Number);
  return [r / 255, g / 255, b / 255, a];
};
const over = (top, below) => below.map((each, k) => top[3] * top[k] + (1 - top[3]) * each);
const linear = (v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
const luminance = ([r, g, b]) => 0.2126 * linear(r) + 0.7152 * linear(g) + 0.0722 * linear(b);
const contrast = (...colours) => {
  const [dark, bright] = colours.map(luminance).sort((a, b) => a - b);
  return (bright + 0.05) / (dark + 0.05);
};
const textOf = (element) =>
  element.matches("input, select") ? element.value : [...element.childNodes].filter((each) => each.nodeType === 3).map((each) => each.data).join("").trim();
const pale = [];
for (const element of document.querySelectorAll("body *:not(option, script, style)")) {
  const text = textOf(element);
  if (!text || !element.checkVisibility({ checkOpacity: true, checkVisibilityCSS: true }) || element.closest("[aria-hidden=true], :disabled")) continue;
  const grounds = [];
  let onPicture = false;
  for (let each = element; each && !onPicture && grounds.at(-1)?.[3] !== 1; each = each.parentElement) {
    grounds.push(parsed(getComputedStyle(each).backgroundColor));
    onPicture = Boolean(each.parentElement?.querySelector(":scope > canvas, :scope > .scenes canvas")) && grounds.at(-1)[3] !== 1;
  }
  for (const picture of onPicture ? [[0, 0, 0], [1, 1, 1]] : [[0, 0, 0]]) {
    const below = grounds.reduceRight((ground, top) => over(top, ground), picture);
    const found = contrast(over(parsed(getComputedStyle(element).color), below), below);
    if (found < LEAST) pale.push(`${text.slice(0, 40)}: ${found.toFixed(2)}`);
  }
}
const named = (each) => each.ariaLabel || each.title || each.innerText?.trim() || each.labels?.length || each.getAttribute("aria-labelledby");
const controls = [...document.querySelectorAll("button, input, select, textarea, canvas, [role=option]")];
const nameless = controls.filter((each) => each.checkVisibility() && !each.closest("[aria-hidden=true]") && !named(each));
return [pale, nameless.map((each) => each.outerHTML.slice(0, 120))];
