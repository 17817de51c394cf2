// The fleet's table: a row per drone, each value with its age. Roles are explicit: page.css lays it out as rows.

import { ageMs, byId, el, fixed, keyOf, named, seconds, setText } from "./dom.js";

const state = (name, show) => (drone) => {
  const known = drone.states[name];
  return known === undefined ? null : { text: show(known), known };
};
const words = (text) => text.replaceAll("_", " ");
const plain = (show) => (drone, page) => ({ text: show(drone, page), known: null });

export function holder(drone, page) {
  if (drone.mine) return "this station";
  if (drone.holder === page.names[drone.fleet]) return `another ${drone.holder}`;
  return drone.holder === null ? "nobody" : drone.holder;
}

// The order of the drones.
const orderOf = ({ fleet, fog, drone }) => [fleet, Number(`${fog}`.split("/").at(-1)), drone];

function isBefore(one, other) {
  const index = one.findIndex((part, at) => part !== other[at]);
  return index >= 0 && one[index] < other[index];
}

const COLUMNS = [
  ["Reachable", plain((drone) => (drone.reachable ? "yes" : "no"))],
  ["Control", plain(holder)],
  ["Armed", state("armed", (known) => (known.armed ? "armed" : "no"))],
  ["Mode", state("flight_mode", (known) => words(known.mode))],
  ["Landed", state("landed_state", (known) => words(known.landed))],
  ["Height", state("location", (known) => `${fixed(known.altitude_m, 1)} m`)],
  ["Speed", state("groundspeed", (known) => `${fixed(known.groundspeed_m_s, 1)} m/s`)],
  ["Battery", state("battery", (known) => `${known.remaining_pct} %`)],
];

export class Fleet {
  constructor(page) {
    this.page = page;
    this.rows = new Map();
    for (const name of ["Select", "Drone", "Fog", ...COLUMNS.map(([heading]) => heading)]) {
      byId("fleet-head").append(el("th", { role: "columnheader", scope: "col" }, name));
    }
    this.fleetHead = el("th", { role: "columnheader", scope: "col" }, "Fleet");
    byId("select-all").addEventListener("click", () => page.select([...page.drones.keys()]));
    byId("select-none").addEventListener("click", () => page.select([]));
    setInterval(() => this.tick(), 1000);
  }

  // Several fleets get a column of their own.
  begin(hasFleets) {
    document.body.classList.toggle("fleets", hasFleets);
    if (hasFleets) byId("fleet-head").children[1].after(this.fleetHead);
  }

  update(drone) {
    const key = keyOf(drone);
    let row = this.rows.get(key);
    if (row === undefined) {
      row = this.add(key, drone);
      this.rows.set(key, row);
    }
    this.show(row, drone);
  }

  add(key, drone) {
    const label = `Select drone ${named(drone.fleet, drone.drone)} of fog ${drone.fog}`;
    const box = el("input", { type: "checkbox", "aria-label": label });
    box.addEventListener("change", () => this.page.toggle(key));
    const cells = COLUMNS.map(([heading]) => ({ heading, value: el("span"), age: el("small") }));
    const order = orderOf(drone);
    const fleet = drone.fleet ? [el("td", { role: "cell", "data-heading": "Fleet" }, drone.fleet)] : [];
    const line = el(
      "tr",
      { role: "row", "data-drone": key },
      el("td", { role: "cell" }, box),
      el("th", { role: "rowheader", scope: "row" }, `${drone.drone}`),
      ...fleet,
      el("td", { role: "cell", "data-heading": "Fog" }, `${order[1]}`),
      ...cells.map((cell) => el("td", { role: "cell", "data-heading": cell.heading }, cell.value, " ", cell.age)),
    );
    line.addEventListener("click", (event) => {
      if (event.target !== box) this.page.toggle(key);
    });
    const next = [...this.rows.values()].find((other) => isBefore(order, other.order));
    byId("fleet-rows").insertBefore(line, next === undefined ? null : next.line);
    return { line, box, cells, order };
  }

  show(row, drone) {
    COLUMNS.forEach(([, of], index) => {
      const { value, age } = row.cells[index];
      const found = of(drone, this.page);
      const old = found === null || found.known === null ? null : ageMs(drone, found.known);
      setText(value, found === null ? "–" : found.text);
      setText(age, old === null ? "" : seconds(old));
      const isState = found !== null && found.known !== null;
      value.classList.toggle("stale", isState && (!drone.reachable || (old !== null && old > this.page.staleMs)));
    });
    row.line.classList.toggle("unreachable", !drone.reachable);
  }

  // These drones in the order of the table.
  inOrder(keys) {
    const drones = [...keys].map((key) => this.page.drones.get(key));
    return drones.sort((one, other) => (isBefore(orderOf(one), orderOf(other)) ? -1 : 1));
  }

  mark(selected) {
    for (const [key, row] of this.rows) {
      row.box.checked = selected.has(key);
      row.line.classList.toggle("selected", selected.has(key));
    }
  }

  tick() {
    for (const [key, row] of this.rows) this.show(row, this.page.drones.get(key));
  }
}
