// The map: metres east and north of the first known position, on a grid or over tiles.
//
// Only changes are painted. The plan's path and the drawn mission are in metres, so that moving the view changes
// one transform.

import { ageMs, byId, keyOf, named, setText, shape } from "./dom.js";
import { Marks } from "./marks.js";
import { Tiles } from "./tiles.js";

const EARTH_M = 6371000;
const RADIANS = Math.PI / 180;
const TRAIL = 240;
const TRAIL_STEP_M = 0.5;
const LEAST_M = 40;
const DRAG_PX = 4;
const KEY_PX = 10; // an arrow key moves the view by this, with Shift by ten times this
const ARROWS = { ArrowUp: [0, 1], ArrowDown: [0, -1], ArrowLeft: [-1, 0], ArrowRight: [1, 0] }; // east and north
const NEAR_PX = 14;
const ROOM = 1.3; // the fitted view is this much larger than its content
const LEAST_ROOM = 1.05;
const MOST_ROOM = 1.8;

// Great-circle distance on a sphere.
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

// The distance of two fingers, in pixels; at least 1.
function apart(fingers) {
  const [one, other] = [...fingers.values()];
  return Math.max(1, Math.hypot(one.x - other.x, one.y - other.y));
}

const translated = ({ x, y }) => `translate(${x.toFixed(1)} ${y.toFixed(1)})`;
const line = (places) => places.map(({ x, y }) => `${x.toFixed(2)},${y.toFixed(2)}`).join(" ");

export class FleetMap {
  constructor(page) {
    this.page = page;
    this.svg = byId("map");
    this.tiles = new Tiles(this);
    this.marks = new Marks(this);
    this.grid = shape("g", { class: "grid" });
    this.path = shape("polyline", { class: "path" });
    this.draftPath = shape("polyline", { class: "draft" });
    this.metres = shape("g", {}, this.path, this.draftPath);
    this.goals = shape("g", { class: "goals" });
    this.drones = shape("g", { class: "drones" });
    this.waypoints = shape("g", { class: "waypoints" });
    this.chosen = shape("g", { class: "chosen" });
    this.frame = shape("g", { class: "frame" });
    this.svg.append(this.grid, this.tiles.names, this.page.places.signs, this.metres, this.goals, this.chosen, this.drones, this.waypoints, this.frame);
    this.seen = new Map();
    this.changed = new Set();
    this.origin = null;
    this.centre = { x: 0, y: 0 };
    this.perM = 4; // pixels per metre
    this.isFitted = true;
    this.isFittedAnew = false;
    this.isDue = false;
    this.view = "";
    byId("map-in").addEventListener("click", () => this.zoom(1.5));
    byId("map-out").addEventListener("click", () => this.zoom(1 / 1.5));
    byId("map-fit").addEventListener("click", () => {
      this.isFitted = this.isFittedAnew = true;
      this.draw();
    });
    this.svg.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(event.deltaY < 0 ? 1.2 : 1 / 1.2);
    });
    this.listen();
    setInterval(() => this.seen.forEach((seen, key) => this.showAge(seen, this.page.drones.get(key))), 1000);
    [this.width, this.height] = [this.svg.clientWidth, this.svg.clientHeight];
    new ResizeObserver(([{ contentRect }]) => {
      [this.width, this.height] = [contentRect.width, contentRect.height]; // reading it in a frame would force a layout
      this.draw();
    }).observe(this.svg);
  }

  listen() {
    let from = null;
    const down = new Map(); // the positions of the fingers, or of the mouse
    this.svg.addEventListener("pointerdown", (event) => {
      down.set(event.pointerId, this.pixelsOf(event));
      if (down.size > 1) {
        from = null; // two fingers zoom, and do not click
        return;
      }
      const waypoint = this.page.isDrawing() ? this.waypointAt(this.pixelsOf(event)) : -1;
      from = { x: event.clientX, y: event.clientY, centre: { ...this.centre }, moved: false, waypoint };
      this.svg.setPointerCapture(event.pointerId);
    });
    this.svg.addEventListener("pointermove", (event) => {
      if (down.size === 2 && down.has(event.pointerId)) {
        const before = apart(down);
        down.set(event.pointerId, this.pixelsOf(event));
        this.zoom(apart(down) / before);
      }
      if (from === null) return;
      const [dx, dy] = [event.clientX - from.x, event.clientY - from.y];
      const begins = !from.moved && Math.hypot(dx, dy) > DRAG_PX;
      from.moved = from.moved || begins;
      if (!from.moved) return;
      this.isFitted = false;
      if (from.waypoint >= 0) {
        this.page.moveWaypoint(from.waypoint, this.toDegrees(this.toMetres(this.pixelsOf(event))), begins);
      } else {
        this.centre = { x: from.centre.x - dx / this.perM, y: from.centre.y + dy / this.perM };
        this.draw();
      }
    });
    this.svg.addEventListener("pointerup", (event) => {
      down.delete(event.pointerId);
      const wasClick = from !== null && !from.moved && from.waypoint < 0;
      from = null;
      if (wasClick) this.click(this.pixelsOf(event));
    });
    this.svg.addEventListener("pointercancel", (event) => {
      down.delete(event.pointerId);
      from = null;
    });
    this.svg.addEventListener("keydown", (event) => this.onKey(event));
  }

  // Without a mouse: the arrow keys move the view, Enter clicks in its middle.
  onKey(event) {
    if (event.key === "Enter") {
      if (!event.repeat) this.click({ x: this.width / 2, y: this.height / 2 });
    } else if (ARROWS[event.key] !== undefined) {
      const [east, north] = ARROWS[event.key].map((way) => (way * (event.shiftKey ? 10 : 1) * KEY_PX) / this.perM);
      this.isFitted = false;
      this.centre = { x: this.centre.x + east, y: this.centre.y + north };
      this.draw();
    } else {
      return;
    }
    event.preventDefault();
  }

  pixelsOf(event) {
    const box = this.svg.getBoundingClientRect();
    return { x: event.clientX - box.left, y: event.clientY - box.top };
  }

  click(at) {
    const isNear = (px) => Math.hypot(px.x - at.x, px.y - at.y) < NEAR_PX;
    const near = [...this.seen].find(([, seen]) => isNear(this.toPixels(seen.place)));
    if (this.origin === null) return;
    const place = this.toDegrees(this.toMetres(at));
    const named = this.page.places.at(at);
    if (this.page.isDrawing()) this.page.addWaypoint(place);
    else if (near !== undefined) this.page.toggle(near[0]);
    else if (named !== undefined) this.page.places.choose(named);
    else this.page.choosePlace(place);
  }

  waypointAt(at) {
    const isNear = (px) => Math.hypot(px.x - at.x, px.y - at.y) < NEAR_PX;
    return this.draftPlaces().findLastIndex((place) => isNear(this.toPixels(place)));
  }

  // The middle of the map, in degrees; null before the first known position.
  middle() {
    return this.origin === null ? null : this.toDegrees(this.centre);
  }

  update(drone) {
    const location = drone.states.location;
    if (location === undefined) return;
    if (this.origin === null) {
      this.origin = location;
      this.page.places.locate();
    }
    const key = keyOf(drone);
    let seen = this.seen.get(key);
    if (seen === undefined) seen = this.add(key, drone);
    seen.place = this.toPlace(location);
    seen.home = drone.states.home === undefined ? null : this.toPlace(drone.states.home);
    seen.arrow.setAttribute("transform", `rotate(${drone.states.heading?.heading_deg ?? 0})`);
    this.showAge(seen, drone);
    this.extend(seen);
    this.changed.add(seen);
    this.draw();
  }

  // A position that is too old to go by looks it, as in the table.
  showAge({ marker }, drone) {
    const { location } = drone.states;
    const isOld = location === undefined || ageMs(drone, location) > this.page.staleMs;
    marker.classList.toggle("stale", isOld || !drone.reachable);
  }

  add(key, drone) {
    const arrow = shape("path", { d: "M0,-11 L7,9 L0,5 L-7,9 Z" });
    const marker = shape("g", { "data-marker": key }, arrow);
    const seen = { place: null, home: null, trail: [], fresh: [], marker, arrow, name: named(drone.fleet, drone.drone) };
    this.drones.append(marker);
    this.seen.set(key, seen);
    this.mark(this.page.selected);
    return seen;
  }

  extend({ place, trail, fresh }) {
    const last = trail.at(-1);
    if (last !== undefined && Math.hypot(last.x - place.x, last.y - place.y) <= TRAIL_STEP_M) return;
    trail.push(place);
    fresh.push(place);
    if (trail.length > TRAIL) trail.shift();
  }

  mark(selected) {
    for (const [key, seen] of this.seen) seen.marker.classList.toggle("selected", selected.has(key));
    this.marks.isWhole = false;
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

  // The view stays while it contains everything, not too small: a map that moves with every metre cannot be read.
  fit() {
    const places = [...this.seen.values()].flatMap((seen) => [seen.place, seen.home]).filter((place) => place !== null);
    places.push(...this.goalPlaces(), ...this.draftPlaces(), ...this.page.places.near);
    if (this.origin !== null) places.push(...this.page.looked().map((place) => this.degreesToPlace(place)));
    if (this.page.found !== null && this.origin !== null) places.push(this.toPlace(this.page.found));
    if (places.length === 0) return;
    const [xs, ys] = [places.map((place) => place.x), places.map((place) => place.y)];
    const [left, right, low, high] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
    const room = (share) =>
      Math.min(
        this.width / Math.max(LEAST_M, (right - left) * share),
        this.height / Math.max(LEAST_M, (high - low) * share),
      );
    const [corner, other] = [this.toPixels({ x: left, y: high }), this.toPixels({ x: right, y: low })];
    const isWithin = Math.min(corner.x, corner.y, this.width - other.x, this.height - other.y) >= 0;
    const isGood = isWithin && this.perM <= room(LEAST_ROOM) && this.perM >= room(MOST_ROOM);
    if (isGood && !this.isFittedAnew) return;
    this.isFittedAnew = false;
    this.centre = { x: (left + right) / 2, y: (low + high) / 2 };
    this.perM = room(ROOM);
  }

  goalPlaces() {
    if (this.origin === null) return [];
    return this.page.goals().map((place) => this.degreesToPlace(place));
  }

  draftPlaces() {
    return this.origin === null ? [] : this.page.drawn().map((waypoint) => this.toPlace(waypoint));
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
    if (this.isFitted && !this.page.isDrawing()) this.fit();
    const { x, y } = this.toPixels({ x: 0, y: 0 });
    const view = [x, y, this.perM, this.width, this.height].join(" ");
    const isMoved = view !== this.view;
    this.view = view;
    if (isMoved) {
      this.metres.setAttribute("transform", `translate(${x} ${y}) scale(${this.perM} ${-this.perM})`);
      this.paintGrid();
      this.marks.isWhole = false;
    }
    if (isMoved || this.tiles.isChanged) this.tiles.paint();
    if (isMoved || this.page.places.isChanged) this.page.places.paint();
    for (const seen of isMoved ? this.seen.values() : this.changed) {
      seen.marker.setAttribute("transform", translated(this.toPixels(seen.place)));
    }
    this.marks.paint(this.page.selected);
    this.changed.clear();
    this.goals.replaceChildren(...this.goalPlaces().map((place) => this.sign("✕", this.toPixels(place))));
    const chosen = this.page.place === null || this.origin === null ? [] : [this.toPixels(this.toPlace(this.page.place))];
    this.chosen.replaceChildren(...chosen.map(({ x, y }) => shape("circle", { cx: x, cy: y, r: 8 })));
    const path = this.origin === null ? [] : this.page.path().map((place) => this.degreesToPlace(place));
    this.path.setAttribute("points", line(path));
    this.paintDraft(this.draftPlaces());
  }

  paintDraft(places) {
    this.draftPath.setAttribute("points", line(places));
    this.waypoints.replaceChildren(
      ...places.map((place, index) =>
        shape(
          "g",
          { transform: translated(this.toPixels(place)), "data-waypoint": index + 1 },
          shape("circle", { r: 10 }),
          shape("text", { y: 5, "text-anchor": "middle" }, `${index + 1}`),
        ),
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
    const [x, y] = [this.width / 2, this.height / 2];
    this.frame.replaceChildren(
      shape("path", { class: "middle", d: `M${x - 12},${y} H${x + 12} M${x},${y - 12} V${y + 12}` }),
      shape("path", { d: `M12,${bottom - 6} V${bottom} H${12 + length} V${bottom - 6}` }),
      shape("text", { x: 16, y: bottom - 6 }, long),
      shape("path", { d: `M${this.width - 22},34 V12 M${this.width - 27},19 L${this.width - 22},12 L${this.width - 17},19` }),
      shape("text", { x: this.width - 22, y: 48, "text-anchor": "middle" }, "N"),
    );
    setText(byId("map-scale"), `a square of the grid: ${long}`);
  }
}
