// Canvases of what changes with every position: trails, homes and the drones' numbers. As elements a large fleet's
// texts would be laid out again in every frame. A trail is extended; it is painted whole if the view has changed.

import { byId } from "./dom.js";

const COLOURS = { ink: "--ink", soft: "--soft", accent: "--accent" };
const WHOLE_MS = 30000; // how long the outdated end of a trail may stay
const FONT = "13px system-ui, sans-serif";
const HOME_FONT = "22px system-ui, sans-serif"; // large enough to show around a drone that stands there

export class Marks {
  constructor(map) {
    this.map = map;
    this.trails = byId("trails");
    this.marks = byId("marks");
    this.isWhole = false;
    this.paintedMs = 0;
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      this.readColours();
      this.isWhole = false;
      map.draw();
    });
    this.readColours();
  }

  readColours() {
    const style = getComputedStyle(document.documentElement);
    const named = Object.entries(COLOURS).map(([name, property]) => [name, style.getPropertyValue(property)]);
    this.colours = Object.fromEntries(named);
  }

  // Prepare a canvas as large as the map, to draw in the map's pixels.
  begin(canvas, isCleared) {
    const { width, height } = this.map;
    const sharp = devicePixelRatio;
    const size = [Math.round(width * sharp), Math.round(height * sharp)];
    if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
    const context = canvas.getContext("2d");
    context.setTransform(sharp, 0, 0, sharp, 0, 0);
    if (isCleared) context.clearRect(0, 0, width, height);
    return context;
  }

  paint(selected) {
    this.paintTrails(selected);
    const context = this.begin(this.marks, true);
    context.fillStyle = this.colours.ink;
    [context.font, context.textAlign] = [HOME_FONT, "center"];
    for (const { home } of this.map.seen.values()) if (home !== null) this.text(context, "⌂", home, 0, 8);
    [context.font, context.textAlign] = [FONT, "left"];
    for (const { place, name } of this.map.seen.values()) this.text(context, name, place, 11, 4);
  }

  paintTrails(selected) {
    const isOld = performance.now() - this.paintedMs > WHOLE_MS;
    if (isOld) this.isWhole = false;
    if (!this.isWhole) this.paintedMs = performance.now();
    const context = this.begin(this.trails, !this.isWhole);
    for (const [key, seen] of this.map.seen) {
      const places = this.isWhole ? seen.fresh : seen.trail;
      if (places.length > 1) this.trail(context, places, selected.has(key));
      seen.fresh = seen.trail.slice(-1);
    }
    this.isWhole = true;
  }

  text(context, text, place, right, down) {
    const { x, y } = this.map.toPixels(place);
    context.fillText(text, x + right, y + down);
  }

  trail(context, places, isSelected) {
    context.strokeStyle = isSelected ? this.colours.accent : this.colours.soft;
    context.lineWidth = isSelected ? 2.5 : 1.5;
    context.beginPath();
    for (const place of places) {
      const { x, y } = this.map.toPixels(place);
      context.lineTo(x, y);
    }
    context.stroke();
  }
}
