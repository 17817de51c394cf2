// Named places: signs on the map, and a list beside Go to that is searched by a part of the name. Choosing a place
// only fills in Go to.

import { byId, el, setText, shape } from "./dom.js";

const MOST_LISTED = 8;
const NEAR_M = 300; // places this near to the map's origin belong to the fitted view
const NEAR_PX = 14;
const [LETTER_PX, LINE_PX, BELOW_PX] = [7.5, 16, 22]; // of a name below its sign

// Without case and accents, so that "eglise" finds "Église".
const plain = (text) => text.normalize("NFD").replace(/\p{Mark}/gu, "").toLowerCase();
const isAt = (place, other) => place.latitude_deg === other.latitude_deg && place.longitude_deg === other.longitude_deg;

export class Places {
  constructor(page) {
    this.page = page;
    this.all = [];
    this.located = []; // with their positions on the map
    this.near = [];
    this.drawn = [];
    this.buttons = [];
    this.isChanged = false;
    this.signs = shape("g", { class: "places" });
    this.form = byId("places");
    this.form.addEventListener("submit", (event) => {
      event.preventDefault();
      this.chooseFound();
    });
    byId("place-name").addEventListener("input", () => this.list());
  }

  begin(places) {
    if (JSON.stringify(places) === JSON.stringify(this.all)) return; // the program is back: typed text stays
    this.all = places;
    this.locate();
    this.form.hidden = byId("map-places").hidden = places.length === 0;
    this.list();
  }

  // Compute their positions on the map; none before the map has its origin.
  locate() {
    const { map } = this.page;
    this.located = map.origin === null ? [] : this.all.map((place) => ({ ...place, at: map.toPlace(place) }));
    this.near = this.located.map(({ at }) => at).filter(({ x, y }) => Math.hypot(x, y) <= NEAR_M);
    this.isChanged = true;
    map.draw();
  }

  get wanted() {
    return plain(byId("place-name").value.trim());
  }

  found() {
    return this.all.filter(({ name }) => plain(name).includes(this.wanted));
  }

  list() {
    const found = this.found();
    const shown = found.slice(0, MOST_LISTED);
    this.buttons = shown.map((place) => [place, el("button", { type: "button" }, place.name)]);
    for (const [place, button] of this.buttons) button.addEventListener("click", () => this.choose(place));
    byId("place-list").replaceChildren(...this.buttons.map(([, button]) => el("li", {}, button)));
    const more = found.length - shown.length;
    setText(byId("place-more"), more > 0 ? `and ${more} more: type a part of the name` : "");
    this.show();
  }

  // Enter in the field chooses the one place that it names; otherwise the reason is shown.
  chooseFound() {
    const found = this.found();
    const exact = found.filter(({ name }) => plain(name) === this.wanted);
    const [place, ...others] = exact.length > 0 ? exact : found;
    if (place !== undefined && others.length === 0) this.choose(place);
    else this.say(found.length === 0 ? "No place has this in its name." : `${found.length} places: choose one.`);
  }

  choose({ name, latitude_deg, longitude_deg }) {
    this.page.choosePlace({ latitude_deg, longitude_deg });
    this.page.findPlace();
    this.say(`${name} is filled in below. Look at it, and send Go to.`);
  }

  say(text) {
    setText(byId("place-found"), text);
  }

  // The name of a position, null if no named place is there.
  nameOf(place) {
    return (place !== null && this.all.find((one) => isAt(one, place))?.name) || null;
  }

  show() {
    const { place } = this.page;
    for (const [one, button] of this.buttons) {
      button.setAttribute("aria-pressed", place !== null && isAt(one, place));
    }
    if (this.nameOf(place) === null) this.say("");
  }

  // Paint each visible sign, with its name inside the map unless that covers another name.
  paint() {
    const { map } = this.page;
    this.isChanged = false;
    this.drawn = [];
    const most = Math.floor(map.width / LETTER_PX);
    for (const { at, ...place } of this.located) {
      const { x, y } = map.toPixels(at);
      if (x < 0 || x > map.width || y < 0 || y > map.height) continue;
      const text = place.name.length > most ? `${place.name.slice(0, most - 1)}…` : place.name;
      const wide = text.length * LETTER_PX;
      const middle = Math.max(wide / 2, Math.min(map.width - wide / 2, x));
      const covers = (other) =>
        Math.abs(middle - other.middle) * 2 < wide + other.wide && Math.abs(y - other.y) < LINE_PX && other.wide > 0;
      this.drawn.push({ place, text, x, y, middle, wide: this.drawn.some(covers) ? 0 : wide });
    }
    this.signs.replaceChildren(
      ...this.drawn.flatMap(({ text, x, y, middle, wide }) => {
        const sign = shape("path", { d: `M${x.toFixed(1)},${(y - 6).toFixed(1)} l6,6 l-6,6 l-6,-6 Z` });
        const below = { x: middle.toFixed(1), y: (y + BELOW_PX).toFixed(1), "text-anchor": "middle" };
        return wide > 0 ? [sign, shape("text", below, text)] : [sign];
      }),
    );
  }

  // The place whose sign or name is at a position.
  at({ x, y }) {
    const isOn = (one) =>
      Math.hypot(one.x - x, one.y - y) < NEAR_PX ||
      (Math.abs(one.middle - x) * 2 < one.wide && y > one.y && y < one.y + BELOW_PX + 4);
    return this.drawn.find(isOn)?.place;
  }
}
