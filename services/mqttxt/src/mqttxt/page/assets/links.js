// Links of a testbed: the traffic and state of each, and sliders that change it.

import { byId, el, setText } from "./dom.js";

const UNLIMITED = "unlimited";
// From left to right on the slider, each with its bits per second.
const RATES = [
  ...[["9600bit", 9600], ["64kbit", 64e3], ["250kbit", 250e3], ["1Mbit", 1e6], ["5Mbit", 5e6], ["20Mbit", 20e6]],
  [UNLIMITED, Infinity],
];
const LONGEST_MS = 3000;
const STEP_MS = 10;

const number = (value) => (value < 9.95 ? value.toFixed(1) : Math.round(value).toString());

function stateOf(figures) {
  if (figures.is_closed) return "cut";
  const rate = figures.rate_bps === null ? UNLIMITED : `${figures.rate_bps / 1000} kbit/s`;
  return `${rate}, ${figures.delay_ms} ms, ${Number((figures.loss * 100).toFixed(2))} % lost`;
}

export class Links {
  constructor(page) {
    this.page = page;
    this.rows = new Map();
  }

  begin(title) {
    byId("links-section").hidden = title === null;
    setText(byId("links-title"), `Links, as ${title} uses them`);
  }

  // Each entry is one direction; a row is a link.
  update(directions) {
    const links = new Map();
    for (const figures of directions) {
      const [name, way] = figures.name.split(/:(?=[^:]*$)/);
      links.set(name, { ...links.get(name), [way]: figures });
    }
    for (const [name, { up, down }] of links) {
      if (!this.rows.has(name)) this.rows.set(name, this.add(name));
      const row = this.rows.get(name);
      for (const [way, figures] of [["up", up], ["down", down]]) {
        setText(row[way].carried, `${number(figures.packets_per_s)}/s, ${number(figures.bytes_per_s)} B/s`);
        setText(row[way].state, stateOf(figures));
      }
      row.line.classList.toggle("changed", up.is_changed || down.is_changed);
      if (!row.line.contains(document.activeElement)) this.set(row, up);
    }
  }

  add(name) {
    const id = (what) => `link-${name.replaceAll(":", "-")}-${what}`;
    const slider = (what, label, max, step) =>
      el("input", { type: "range", id: id(what), min: 0, max, step, "aria-label": `${label} of ${name}` });
    const row = {
      up: { carried: el("td"), state: el("td") },
      down: { carried: el("td"), state: el("td") },
      delay: slider("delay", "Delay", LONGEST_MS, STEP_MS),
      loss: slider("loss", "Loss", 100, 1),
      rate: slider("rate", "Rate", RATES.length - 1, 1),
      cut: el("input", { type: "checkbox", id: id("cut"), "aria-label": `Cut ${name}` }),
      back: el("button", { type: "button", id: id("back"), "aria-label": `${name} as planned` }, "As planned"),
    };
    const change = (figures) => this.page.ask("link", { link: name, figures, closed: row.cut.checked });
    row.delay.addEventListener("change", () => change({ delay: `${row.delay.value}ms` }));
    row.loss.addEventListener("change", () => change({ loss: `${row.loss.value}%` }));
    row.rate.addEventListener("change", () => change({ rate: RATES[row.rate.valueAsNumber][0] }));
    row.cut.addEventListener("change", () => change({}));
    row.back.addEventListener("click", () => this.page.ask("link", { link: name, back: true }));
    for (const input of [row.delay, row.loss, row.rate]) input.addEventListener("input", () => this.describe(row));
    const inputs = [row.delay, row.loss, row.rate, row.cut, row.back].map((input) => el("td", {}, input));
    row.line = el(
      "tr",
      { "data-link": name },
      el("th", { scope: "row" }, name),
      ...[row.up, row.down].flatMap((way) => [way.carried, way.state]),
      ...inputs,
    );
    byId("links-rows").append(row.line);
    return row;
  }

  // Set the sliders to the link's present figures.
  set(row, figures) {
    row.delay.value = figures.delay_ms;
    row.loss.value = figures.loss * 100;
    row.rate.value = RATES.findIndex(([, bits]) => bits >= (figures.rate_bps ?? Infinity));
    row.cut.checked = figures.is_closed;
    this.describe(row);
  }

  describe(row) {
    row.delay.setAttribute("aria-valuetext", `${row.delay.value} ms`);
    row.loss.setAttribute("aria-valuetext", `${row.loss.value} %`);
    row.rate.setAttribute("aria-valuetext", RATES[row.rate.valueAsNumber][0]);
    for (const input of [row.delay, row.loss, row.rate]) input.title = input.getAttribute("aria-valuetext");
  }
}
