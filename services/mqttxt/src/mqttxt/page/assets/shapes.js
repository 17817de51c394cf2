// A vector tile as a picture in the page's colours (areas, ways, buildings), and the names to write over it.

import { PbfReader } from "./pbf.js";
import { VectorTile } from "./vector-tile.js";

const SIZE = 512;
const [POINT, LINE, AREA] = [1, 2, 3];
const LONGEST = 60; // characters of a name
// From the lowest up: the layers' names in Protomaps' and in OpenMapTiles' schema, and the colour's name in page.css.
const PAINTED = [
  [["earth"], "--earth"],
  [["landcover", "landuse", "park"], "--green"],
  [["water", "waterway"], "--water"],
  [["buildings", "building"], "--building"],
  [["roads", "transportation"], "--road"],
  [["boundaries", "boundary"], "--line"],
];
// Places come before points of interest, which are labelled with their kind too.
const NAMED = [["places", false], ["place", false], ["pois", true], ["poi", true]];
const WIDE = new Set(["highway", "major_road", "motorway", "trunk", "primary", "secondary"]);

export function readShapes(bytes) {
  const layers = new VectorTile(new PbfReader(new Uint8Array(bytes))).layers;
  return { picture: paintShapes(layers), names: NAMED.flatMap(([name, isOfInterest]) => named(layers[name], isOfInterest)) };
}

// Each name with its position in the tile: 0 to 1, eastward and southward.
function named(layer, isOfInterest) {
  const found = [];
  for (let index = 0; index < (layer?.length ?? 0); index += 1) {
    const feature = layer.feature(index);
    const { name, kind = feature.properties.class } = feature.properties;
    if (feature.type !== POINT || name === undefined) continue;
    const [[{ x, y }]] = feature.loadGeometry();
    const [across, down] = [x / layer.extent, y / layer.extent];
    if (Math.min(across, down) < 0 || Math.max(across, down) >= 1) continue; // it belongs to a neighbouring tile
    const text = isOfInterest && kind !== undefined ? `${name}, ${kind}`.replaceAll("_", " ") : `${name}`;
    found.push({ text: text.slice(0, LONGEST), across, down });
  }
  return found;
}

function paintShapes(layers) {
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
