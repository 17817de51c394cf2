// Elements without markup: texts from elsewhere are never more than text.

const SVG = "http://www.w3.org/2000/svg";

export const byId = (id) => document.getElementById(id);

function fill(node, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (value !== false && value !== null) node.setAttribute(name, value === true ? "" : value);
  }
  node.append(...children);
  return node;
}

export const el = (tag, attributes = {}, ...children) => fill(document.createElement(tag), attributes, children);

export const shape = (tag, attributes = {}, ...children) =>
  fill(document.createElementNS(SVG, tag), attributes, children);

export function setText(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

// A number for display: one that rounds to zero has no sign.
export const fixed = (value, digits) => (Math.round(value * 10 ** digits) === 0 ? 0 : value).toFixed(digits);

// The number in a field, NaN if it has none. A browser's own number field drops a comma: 1,5 becomes 15.
export const numberIn = (input) => (/^[-+]?(\d+\.?\d*|\.\d+)$/.test(input.value.trim()) ? Number(input.value) : NaN);

// Whether a field has a number within its limits; if not, the browser shows the expectation.
export function hasNumber(input) {
  const [low, high] = [Number(input.dataset.low), Number(input.dataset.high)];
  const value = numberIn(input);
  const expected = `Expected a number from ${low} to ${high}, with a point before decimals, as 12.5`;
  input.setCustomValidity(value >= low && value <= high ? "" : expected);
  return input.reportValidity();
}

// Among several fleets a fog's name includes its fleet, such as acme/1, so a key is unique.
export const keyOf = (drone) => `${drone.fog}/${drone.drone}`;

// A number, with its fleet if there are several.
export const named = (fleet, number) => (fleet ? `${fleet}/${number}` : `${number}`);

// A state's age now: its age when it was sent, and the time since.
export function ageMs(drone, state) {
  return state.age_ms === null ? null : state.age_ms + performance.now() - drone.at;
}

export const seconds = (ms) => (ms < 9950 ? (ms / 1000).toFixed(1) : Math.round(ms / 1000).toString());
