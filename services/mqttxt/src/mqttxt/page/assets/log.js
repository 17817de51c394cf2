// The log: the newest entries that match the search; the server exports all of its entries.

import { byId, el } from "./dom.js";

const KEPT = 1000;
const SHOWN = 200;

const two = (number) => `${number}`.padStart(2, "0");

// The browser's local time; the export has UTC.
function localTime(iso) {
  const time = new Date(iso);
  const parts = [time.getHours(), time.getMinutes(), time.getSeconds()].map(two).join(":");
  return `${parts}.${`${time.getMilliseconds()}`.padStart(3, "0")}`;
}

export class Log {
  constructor() {
    this.entries = [];
    byId("search").addEventListener("input", () => this.show());
  }

  add(entries) {
    this.entries.push(...entries);
    this.entries.splice(0, Math.max(0, this.entries.length - KEPT));
    this.show();
  }

  clear() {
    this.entries = [];
    this.show();
  }

  show() {
    const search = byId("search").value;
    const wanted = search.toLowerCase();
    const asked = search ? [`search=${encodeURIComponent(search)}`] : [];
    byId("export").href = ["log.jsonl", ...asked].join("?");
    byId("export-all").href = `log.jsonl?${["all", ...asked].join("&")}`;
    const isFound = ({ text, code }) => [text, code ?? ""].some((one) => one.toLowerCase().includes(wanted));
    const found = this.entries.filter(isFound).slice(-SHOWN).reverse();
    byId("log").replaceChildren(
      ...found.map(({ time, text, code }) =>
        el("li", { title: code }, el("time", { datetime: time }, localTime(time)), " ", text),
      ),
    );
  }
}
