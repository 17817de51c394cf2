// Tiles below the map, if the page's server has some: pictures, or shapes that are painted here.

import { byId, setText, shape } from "./dom.js";
import { readShapes } from "./shapes.js";

const TILE_PX = 256;
const KEPT = 300;
const RADIANS = Math.PI / 180;
const [LETTER_PX, LINE_PX] = [6.5, 18]; // of a name
const MOST_LATITUDE = 85.05; // where web maps end

const eastOf = (longitude_deg) => (longitude_deg + 180) / 360;

function southOf(latitude_deg) {
  const latitude = Math.max(-MOST_LATITUDE, Math.min(MOST_LATITUDE, latitude_deg)) * RADIANS;
  return (1 - Math.asinh(Math.tan(latitude)) / Math.PI) / 2;
}

const cornerOf = (zoom, x, y) => ({
  longitude_deg: (x / 2 ** zoom) * 360 - 180,
  latitude_deg: Math.atan(Math.sinh(Math.PI * (1 - (2 * y) / 2 ** zoom))) / RADIANS,
});

export class Tiles {
  constructor(map) {
    this.map = map;
    this.canvas = byId("tiles");
    this.offer = null;
    this.loaded = new Map(); // null: being loaded, or there is none
    this.names = shape("g", { class: "names" });
    this.isChanged = false;
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.begin(this.offer));
  }

  // The server's offer: `lowest` and `highest` zoom, `shapes` or pictures, and `credit`; null: no tiles.
  begin(offer) {
    this.offer = offer;
    this.loaded.clear();
    this.canvas.hidden = offer === null;
    this.names.replaceChildren();
    setText(byId("map-credit"), offer === null ? "" : `Map: ${offer.credit}.`);
    this.show();
  }

  show() {
    this.isChanged = true;
    this.map.draw();
  }

  paint() {
    this.isChanged = false;
    const { map, canvas, offer } = this;
    if (offer === null || map.origin === null) return;
    const sharp = devicePixelRatio;
    [canvas.width, canvas.height] = [Math.round(map.width * sharp), Math.round(map.height * sharp)];
    const context = canvas.getContext("2d");
    context.scale(sharp, sharp);
    const from = map.toDegrees(map.toMetres({ x: 0, y: 0 }));
    const to = map.toDegrees(map.toMetres({ x: map.width, y: map.height }));
    const across = (eastOf(to.longitude_deg) - eastOf(from.longitude_deg)) * TILE_PX;
    const fitting = Math.round(Math.log2(map.width / across));
    const zoom = Math.max(offer.lowest, Math.min(offer.highest, fitting));
    if (zoom > fitting + 4) return; // a view this large would need too many tiles
    const names = [];
    const last = 2 ** zoom - 1;
    const index = (share) => Math.max(0, Math.min(last, Math.floor(share * 2 ** zoom)));
    for (let x = index(eastOf(from.longitude_deg)); x <= index(eastOf(to.longitude_deg)); x += 1) {
      for (let y = index(southOf(from.latitude_deg)); y <= index(southOf(to.latitude_deg)); y += 1) {
        const tile = this.tile(zoom, x, y);
        if (tile === null) continue;
        this.place(context, tile.picture, zoom, x, y);
        for (const { text, across, down } of tile.names) {
          names.push({ text, ...map.toPixels(map.toPlace(cornerOf(zoom, x + across, y + down))) });
        }
      }
    }
    this.write(names);
  }

  // Write the names that are entirely visible and cover no other one; earlier ones take precedence.
  write(names) {
    const taken = [];
    for (const { text, x, y } of names) {
      const wide = text.length * LETTER_PX;
      const isWithin = x > wide / 2 && x < this.map.width - wide / 2 && y > LINE_PX && y < this.map.height;
      const covers = (other) => Math.abs(x - other.x) * 2 < wide + other.wide && Math.abs(y - other.y) < LINE_PX;
      if (isWithin && !taken.some(covers)) taken.push({ text, x, y, wide });
    }
    this.names.replaceChildren(
      ...taken.map(({ text, x, y }) => shape("text", { x: x.toFixed(1), y: y.toFixed(1), "text-anchor": "middle" }, text)),
    );
  }

  place(context, picture, zoom, x, y) {
    const [from, to] = [cornerOf(zoom, x, y), cornerOf(zoom, x + 1, y + 1)].map((corner) =>
      this.map.toPixels(this.map.toPlace(corner)),
    );
    const [left, top] = [Math.round(from.x), Math.round(from.y)];
    context.drawImage(picture, left, top, Math.round(to.x) - left, Math.round(to.y) - top);
  }

  // A tile's picture and names; null while it is loaded, or if there is none.
  tile(zoom, x, y) {
    const name = `tiles/${zoom}/${x}/${y}`;
    const known = this.loaded.get(name);
    if (known !== undefined) return known;
    this.loaded.set(name, null);
    if (this.loaded.size > KEPT) this.loaded.delete(this.loaded.keys().next().value);
    this.load(name, this.offer);
    return null;
  }

  async load(name, offer) {
    let answer, body;
    try {
      answer = await fetch(name);
      body = await answer.blob();
    } catch {
      this.loaded.delete(name); // the network was cut off: the next drawing requests it again
      return;
    }
    if (answer.status !== 200) return;
    const read = async () => ({ picture: await createImageBitmap(body), names: [] });
    const tile = offer.shapes ? readShapes(await body.arrayBuffer()) : await read();
    if (this.offer !== offer || !this.loaded.has(name)) return;
    this.loaded.set(name, tile);
    this.show();
  }
}
