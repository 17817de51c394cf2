// The map: metres east and north of the first place that was heard, on a grid, without tiles.

import { byId, keyOf, shape } from "./dom.js";

const EARTH_M = 6371000;
const RADIANS = Math.PI / 180;
const TRAIL = 240;
const TRAIL_STEP_M = 0.5;
const LEAST_M = 40;
const DRAG_PX = 4;

// On a sphere, as the crow flies.
export function metresBetween(one, other) {
  const [from, to] = [one.latitude_deg * RADIANS, other.latitude_deg * RADIANS];
  const east = Math.sin(((other.longitude_deg - one.longitude_deg) * RADIANS) / 2);
  const north = Math.sin((to - from) / 2);
  return 2 * EARTH_M * Math.asin(Math.sqrt(north ** 2 + Math.cos(from) * Math.cos(to) * east ** 2));
}

function gridStep(metres) {
  const power = 10 ** Math.floor(Math.log10(metres));
  return [1, 2, 5, 10].map((factor) => factor * power).find((step) => step >= metres);
}

export class FleetMap {
  constructor(page) {
    this.page = page;
    this.svg = byId("map");
    this.grid = shape("g", { class: "grid" });
    this.trails = shape("g", { class: "trails" });
    this.path = shape("g", { class: "path" });
    this.homes = shape("g", { class: "homes" });
    this.goals = shape("g", { class: "goals" });
    this.drones = shape("g", { class: "drones" });
    this.chosen = shape("g", { class: "chosen" });
    this.frame = shape("g", { class: "frame" });
    this.svg.append(this.grid, this.path, this.trails, this.homes, this.goals, this.chosen, this.drones, this.frame);
    this.seen = new Map();
    this.origin = null;
    this.centre = { x: 0, y: 0 };
    this.perM = 4; // pixels per metre
    this.isFitted = true;
    this.isDue = false;
    byId("map-in").addEventListener("click", () => this.zoom(1.5));
    byId("map-out").addEventListener("click", () => this.zoom(1 / 1.5));
    byId("map-fit").addEventListener("click", () => {
      this.isFitted = true;
      this.draw();
    });
    this.svg.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(event.deltaY < 0 ? 1.2 : 1 / 1.2);
    });
    this.listen();
    new ResizeObserver(() => this.draw()).observe(this.svg);
  }

  listen() {
    let from = null;
    this.svg.addEventListener("pointerdown", (event) => {
      from = { x: event.clientX, y: event.clientY, centre: { ...this.centre }, moved: false };
      this.svg.setPointerCapture(event.pointerId);
    });
    this.svg.addEventListener("pointermove", (event) => {
      if (from === null) return;
      const [dx, dy] = [event.clientX - from.x, event.clientY - from.y];
      if (Math.hypot(dx, dy) > DRAG_PX) from.moved = true;
      if (!from.moved) return;
      this.isFitted = false;
      this.centre = { x: from.centre.x - dx / this.perM, y: from.centre.y + dy / this.perM };
      this.draw();
    });
    this.svg.addEventListener("pointerup", (event) => {
      const wasClick = from !== null && !from.moved;
      from = null;
      if (wasClick) this.click(event);
    });
    this.svg.addEventListener("pointercancel", () => {
      from = null;
    });
  }

  click(event) {
    const box = this.svg.getBoundingClientRect();
    const at = { x: event.clientX - box.left, y: event.clientY - box.top };
    const near = [...this.seen]
      .filter(([, seen]) => seen.place !== null)
      .map(([key, seen]) => ({ key, px: this.toPixels(seen.place) }))
      .find(({ px }) => Math.hypot(px.x - at.x, px.y - at.y) < 14);
    if (near !== undefined) {
      this.page.toggle(near.key);
    } else if (this.origin !== null) {
      this.page.choosePlace(this.toDegrees(this.toMetres(at)));
    }
  }

  update(drone) {
    const location = drone.states.location;
    if (location === undefined) return;
    if (this.origin === null) this.origin = location;
    const key = keyOf(drone);
    let seen = this.seen.get(key);
    if (seen === undefined) {
      seen = { place: null, home: null, heading: 0, trail: [], drone: drone.drone };
      this.seen.set(key, seen);
    }
    seen.place = this.toPlace(location);
    seen.heading = drone.states.heading?.heading_deg ?? 0;
    seen.home = drone.states.home === undefined ? null : this.toPlace(drone.states.home);
    seen.isStale = !drone.reachable;
    const last = seen.trail.at(-1);
    if (last === undefined || Math.hypot(last.x - seen.place.x, last.y - seen.place.y) > TRAIL_STEP_M) {
      seen.trail.push(seen.place);
      if (seen.trail.length > TRAIL) seen.trail.shift();
    }
    this.draw();
  }

  toPlace({ latitude_deg, longitude_deg }) {
    const shrink = Math.cos(this.origin.latitude_deg * RADIANS);
    return {
      x: (longitude_deg - this.origin.longitude_deg) * RADIANS * EARTH_M * shrink,
      y: (latitude_deg - this.origin.latitude_deg) * RADIANS * EARTH_M,
    };
  }

  toDegrees({ x, y }) {
    const shrink = Math.cos(this.origin.latitude_deg * RADIANS);
    return {
      latitude_deg: this.origin.latitude_deg + y / EARTH_M / RADIANS,
      longitude_deg: this.origin.longitude_deg + x / EARTH_M / RADIANS / shrink,
    };
  }

  toPixels({ x, y }) {
    return { x: this.width / 2 + (x - this.centre.x) * this.perM, y: this.height / 2 - (y - this.centre.y) * this.perM };
  }

  toMetres({ x, y }) {
    return { x: this.centre.x + (x - this.width / 2) / this.perM, y: this.centre.y - (y - this.height / 2) / this.perM };
  }

  zoom(factor) {
    this.isFitted = false;
    this.perM = Math.min(200, Math.max(0.0001, this.perM * factor));
    this.draw();
  }

  fit() {
    const places = [...this.seen.values()].flatMap((seen) => [seen.place, seen.home]).filter((place) => place !== null);
    places.push(...this.goalPlaces());
    if (this.page.found !== null && this.origin !== null) places.push(this.toPlace(this.page.found));
    if (places.length === 0) return;
    const [xs, ys] = [places.map((place) => place.x), places.map((place) => place.y)];
    const [left, right, low, high] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
    this.centre = { x: (left + right) / 2, y: (low + high) / 2 };
    const across = Math.max(LEAST_M, (right - left) * 1.3);
    const up = Math.max(LEAST_M, (high - low) * 1.3);
    this.perM = Math.min(this.width / across, this.height / up);
  }

  goalPlaces() {
    if (this.origin === null) return [];
    return this.page.goals().map((place) => this.degreesToPlace(place));
  }

  degreesToPlace([latitude_deg, longitude_deg]) {
    return this.toPlace({ latitude_deg, longitude_deg });
  }

  draw() {
    if (this.isDue) return;
    this.isDue = true;
    requestAnimationFrame(() => {
      this.isDue = false;
      this.paint();
    });
  }

  paint() {
    this.width = this.svg.clientWidth;
    this.height = this.svg.clientHeight;
    if (this.isFitted) this.fit();
    this.paintGrid();
    this.trails.replaceChildren();
    this.homes.replaceChildren();
    this.drones.replaceChildren();
    for (const [key, seen] of this.seen) this.paintDrone(key, seen);
    this.goals.replaceChildren(...this.goalPlaces().map((place) => this.sign("✕", this.toPixels(place))));
    const chosen = this.page.place === null || this.origin === null ? [] : [this.toPixels(this.toPlace(this.page.place))];
    const path = this.origin === null ? [] : this.page.path().map((place) => this.toPixels(this.degreesToPlace(place)));
    this.path.replaceChildren(shape("polyline", { points: path.map(({ x, y }) => `${x},${y}`).join(" ") }));
    this.chosen.replaceChildren(...chosen.map(({ x, y }) => shape("circle", { cx: x, cy: y, r: 8 })));
  }

  paintDrone(key, seen) {
    const isSelected = this.page.selected.has(key);
    const points = seen.trail.map((place) => this.toPixels(place)).map(({ x, y }) => `${x.toFixed(1)},${y.toFixed(1)}`);
    this.trails.append(shape("polyline", { points: points.join(" "), class: isSelected ? "selected" : null }));
    if (seen.home !== null) this.homes.append(this.sign("⌂", this.toPixels(seen.home)));
    const { x, y } = this.toPixels(seen.place);
    this.drones.append(
      shape(
        "g",
        {
          transform: `translate(${x.toFixed(1)} ${y.toFixed(1)})`,
          class: `${isSelected ? "selected" : ""} ${seen.isStale ? "stale" : ""}`,
          "data-marker": key,
        },
        shape("path", { d: "M0,-11 L7,9 L0,5 L-7,9 Z", transform: `rotate(${seen.heading})` }),
        shape("text", { x: 11, y: 4 }, `${seen.drone}`),
      ),
    );
  }

  sign(text, { x, y }) {
    return shape("text", { x, y: y + 5, "text-anchor": "middle" }, text);
  }

  paintGrid() {
    const step = gridStep(70 / this.perM);
    const [from, to] = [this.toMetres({ x: 0, y: this.height }), this.toMetres({ x: this.width, y: 0 })];
    const lines = [];
    for (let x = Math.ceil(from.x / step) * step; x <= to.x; x += step) {
      const px = this.toPixels({ x, y: 0 }).x;
      lines.push(shape("line", { x1: px, x2: px, y1: 0, y2: this.height }));
    }
    for (let y = Math.ceil(from.y / step) * step; y <= to.y; y += step) {
      const px = this.toPixels({ x: 0, y }).y;
      lines.push(shape("line", { x1: 0, x2: this.width, y1: px, y2: px }));
    }
    this.grid.replaceChildren(...lines);
    const long = step >= 1000 ? `${step / 1000} km` : `${step} m`;
    const [bottom, length] = [this.height - 12, step * this.perM];
    this.frame.replaceChildren(
      shape("path", { d: `M12,${bottom - 6} V${bottom} H${12 + length} V${bottom - 6}` }),
      shape("text", { x: 16, y: bottom - 6 }, long),
      shape("path", { d: `M${this.width - 22},34 V12 M${this.width - 27},19 L${this.width - 22},12 L${this.width - 17},19` }),
      shape("text", { x: this.width - 22, y: 48, "text-anchor": "middle" }, "N"),
    );
    byId("map-scale").textContent = `a square of the grid: ${long}`;
  }
}
