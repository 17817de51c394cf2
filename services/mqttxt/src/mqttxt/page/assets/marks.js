// What changes with every position, on a canvas: trails, homes and the drones' numbers. As elements a large fleet's
// texts would be laid out anew in every frame.

import { byId } from "./dom.js";

const COLOURS = { ink: "--ink", soft: "--soft", accent: "--accent" };
const FONT = "13px system-ui, sans-serif";

export class Marks {
  constructor(map) {
    this.map = map;
    this.canvas = byId("marks");
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      this.readColours();
      map.draw();
    });
    this.readColours();
  }

  readColours() {
    const style = getComputedStyle(document.documentElement);
    const named = Object.entries(COLOURS).map(([name, property]) => [name, style.getPropertyValue(property)]);
    this.colours = Object.fromEntries(named);
  }

  paint(selected) {
    const { map, canvas, colours } = this;
    const sharp = devicePixelRatio;
    const size = [Math.round(map.width * sharp), Math.round(map.height * sharp)];
    if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
    const context = canvas.getContext("2d");
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, ...size);
    context.setTransform(sharp, 0, 0, sharp, 0, 0);
    for (const [key, seen] of map.seen) this.trail(context, seen, selected.has(key));
    context.font = FONT;
    context.fillStyle = colours.ink;
    for (const { place, home, drone } of map.seen.values()) {
      if (home !== null) this.text(context, "⌂", home, -6, 5);
      this.text(context, `${drone}`, place, 11, 4);
    }
  }

  text(context, text, place, right, down) {
    const { x, y } = this.map.toPixels(place);
    context.fillText(text, x + right, y + down);
  }

  trail(context, { trail }, isSelected) {
    context.globalAlpha = isSelected ? 1 : 0.6;
    context.strokeStyle = isSelected ? this.colours.accent : this.colours.soft;
    context.lineWidth = isSelected ? 2.5 : 1.5;
    context.beginPath();
    for (const place of trail) {
      const { x, y } = this.map.toPixels(place);
      context.lineTo(x, y);
    }
    context.stroke();
    context.globalAlpha = 1;
  }
}
