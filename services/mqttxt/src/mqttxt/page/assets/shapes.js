// A vector tile as a picture in the page's colours: areas, ways and buildings, without names.

import { PbfReader } from "./pbf.js";
import { VectorTile } from "./vector-tile.js";

const SIZE = 512;
const [LINE, AREA] = [2, 3];
// From the lowest up: the layers' names in Protomaps' and in OpenMapTiles' schema, and the colour's name in page.css.
const PAINTED = [
  [["earth"], "--earth"],
  [["landcover", "landuse", "park"], "--green"],
  [["water", "waterway"], "--water"],
  [["buildings", "building"], "--building"],
  [["roads", "transportation"], "--road"],
  [["boundaries", "boundary"], "--line"],
];
const WIDE = new Set(["highway", "major_road", "motorway", "trunk", "primary", "secondary"]);

export function paintShapes(bytes) {
  const layers = new VectorTile(new PbfReader(new Uint8Array(bytes))).layers;
  const style = getComputedStyle(document.documentElement);
  const canvas = new OffscreenCanvas(SIZE, SIZE);
  const context = canvas.getContext("2d");
  for (const [names, colour] of PAINTED) {
    context.fillStyle = context.strokeStyle = style.getPropertyValue(colour);
    for (const layer of names.map((name) => layers[name]).filter((layer) => layer !== undefined)) paint(context, layer);
  }
  return canvas;
}

function paint(context, layer) {
  const scale = SIZE / layer.extent;
  for (let index = 0; index < layer.length; index += 1) {
    const feature = layer.feature(index);
    if (feature.type !== LINE && feature.type !== AREA) continue;
    context.beginPath();
    for (const [first, ...others] of feature.loadGeometry()) {
      context.moveTo(first.x * scale, first.y * scale);
      for (const point of others) context.lineTo(point.x * scale, point.y * scale);
    }
    context.lineWidth = WIDE.has(feature.properties.kind ?? feature.properties.class) ? 5 : 2;
    if (feature.type === AREA) context.fill("evenodd");
    else context.stroke();
  }
}
