// Sensors: a chart for each kind that a sensor measures, and its newest value as text.

import { byId, el, named, setText, shape } from "./dom.js";

const KEPT = 300;
const MOST_CHARTS = 500;
const [WIDTH, HEIGHT, EDGE] = [280, 80, 4];

const number = (value) => (Number.isInteger(value) ? `${value}` : value.toPrecision(5));

export class Sensors {
  constructor() {
    this.charts = new Map();
  }

  clear() {
    this.charts.clear();
    byId("sensors").replaceChildren();
  }

  update({ fleet, drone, sensor, kind, unit, points }) {
    const key = JSON.stringify([fleet, drone, sensor, kind]);
    let chart = this.charts.get(key);
    if (chart === undefined) {
      chart = { points: [], newest: el("strong"), range: el("small"), line: shape("polyline") };
      const title = `Drone ${named(fleet, drone)}, sensor ${sensor}: ${kind}`;
      const picture = shape("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, "aria-hidden": "true" }, chart.line);
      chart.item = el("li", {}, el("span", {}, title), " ", chart.newest, picture, chart.range);
      byId("sensors").append(chart.item);
    }
    this.charts.delete(key);
    this.charts.set(key, chart); // in the order of their newest readings
    if (this.charts.size > MOST_CHARTS) this.drop(this.charts.keys().next().value);
    chart.points.push(...points);
    chart.points.sort(([time], [other]) => time - other); // a stored reading arrives behind newer ones
    chart.points.splice(0, Math.max(0, chart.points.length - KEPT));
    this.draw(chart, unit);
  }

  drop(key) {
    this.charts.get(key).item.remove();
    this.charts.delete(key);
  }

  draw(chart, unit) {
    const values = chart.points.map(([, value]) => value);
    const [low, high] = [Math.min(...values), Math.max(...values)];
    const [first, last] = [chart.points[0][0], chart.points.at(-1)[0]];
    const across = (time) => EDGE + ((time - first) / (last - first || 1)) * (WIDTH - 2 * EDGE);
    const up = (value) => HEIGHT - EDGE - ((value - low) / (high - low || 1)) * (HEIGHT - 2 * EDGE);
    const at = chart.points.map(([time, value]) => `${across(time).toFixed(1)},${up(value).toFixed(1)}`);
    chart.line.setAttribute("points", at.join(" "));
    setText(chart.newest, `${number(values.at(-1))} ${unit}`);
    setText(chart.range, `${number(low)} to ${number(high)} ${unit}, last ${values.length} readings`);
  }
}
