// Rankings: the fogs' order of their drones (QoDS), and the newest choices (PSMI) with every figure and reason. Roles
// are explicit, because page.css lays a table out as rows if there is no room.

import { byId, el, named } from "./dom.js";

const figure = (value, unit, digits = 0) => (value === null ? "–" : `${value.toFixed(digits)} ${unit}`);

const QODS = [
  ["Drone", (one) => `${one.drone}`],
  ["Battery", (one) => figure(one.remaining_pct, "%")],
  ["Largest speed", (one) => figure(one.max_groundspeed_m_s, "m/s", 1)],
  ["Age when ranked", (one) => figure(one.age_s, "s", 1)],
];
const PSMI = [
  ["Drone", (one) => `${one.drone}`],
  ["Arrives in", (one) => figure(one.arrival_s, "s", 1)],
  ["Distance", (one) => figure(one.distance_m, "m")],
  ["Largest speed", (one) => figure(one.max_groundspeed_m_s, "m/s", 1)],
  ["Battery", (one) => figure(one.remaining_pct, "%")],
  ["Range", (one) => figure(one.range_m, "m")],
  ["Age when chosen", (one) => figure(one.age_s, "s", 1)],
  ["Left out because", (one) => one.plain ?? "", (one) => one.reason],
];

function table(title, columns, rows) {
  const head = columns.map(([heading]) => el("th", { role: "columnheader", scope: "col" }, heading));
  const cell = (row) => ([heading, show, code = () => null]) =>
    el("td", { role: "cell", "data-heading": heading, title: code(row) ?? null }, show(row));
  const shown = el(
    "table",
    { role: "table", "aria-label": title },
    el("thead", { role: "rowgroup" }, el("tr", { role: "row" }, ...head)),
    el("tbody", { role: "rowgroup" }, ...rows.map((row) => el("tr", { role: "row" }, ...columns.map(cell(row))))),
  );
  return [el("h3", {}, title), shown];
}

export function showRankings({ fogs, lists }) {
  const choices = lists.toReversed().flatMap((list) => {
    const sent = list.chosen === null ? "nobody" : `drone ${named(list.fleet, list.chosen)}`;
    return table(`Choice of fog ${named(list.fleet, list.fog)}: ${sent} (PSMI)`, PSMI, [...list.listed, ...list.left_out]);
  });
  const orders = fogs.flatMap((fog) => table(`Fog ${fog.fog}, best first (QoDS)`, QODS, fog.ranking));
  byId("rankings").replaceChildren(...orders, ...choices);
}
