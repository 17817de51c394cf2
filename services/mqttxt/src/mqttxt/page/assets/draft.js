// The mission editor: waypoints on the map and in a table, undo step by step, and the .plan file.

import { byId, el, hasNumber, numberIn, setText } from "./dom.js";

const [WAYPOINT, RETURN, TAKEOFF] = [16, 20, 22]; // MAV_CMDs
const [WITHOUT_PLACE, ABOVE_HOME] = [2, 3]; // MAV_FRAMEs
const [PX4, MULTICOPTER] = [12, 2]; // QGroundControl's default MAV_AUTOPILOT and MAV_TYPE
const [STEP_M, LONG_STEP_M] = [1, 10];
const WAYS = { ArrowUp: [0, 1], ArrowDown: [0, -1], ArrowRight: [1, 0], ArrowLeft: [-1, 0] };
const DIGITS = { latitude_deg: 7, longitude_deg: 7, altitude_m: 1 };
export const NAME = "drawn.plan";

const item = (number, command, frame, params) => ({
  ...{ type: "SimpleItem", command, frame, params, autoContinue: true, doJumpId: number },
});

export class Draft {
  constructor(page) {
    this.page = page;
    this.waypoints = [];
    this.past = [];
    this.rows = [];
    this.parameters = [];
    byId("draft-draw").addEventListener("change", () => this.show());
    byId("draft-add").addEventListener("click", () => this.addInTheMiddle());
    byId("draft-undo").addEventListener("click", () => this.undo());
    byId("draft-clear").addEventListener("click", () => this.change([]));
    byId("draft-save").addEventListener("click", () => this.save());
    byId("draft-upload").addEventListener("click", () => this.upload());
  }

  // The limits of a place and a height are those of Go to.
  build({ commands }) {
    this.parameters = commands.goto.parameters;
    const height = this.parameters.find(({ name }) => name === "altitude_m");
    Object.assign(byId("draft-height").dataset, { low: height.low, high: height.high });
    setText(byId("draft-height-unit"), `${height.unit}, ${height.low} to ${height.high}`);
    this.show();
  }

  get isDrawing() {
    return byId("draft-draw").checked;
  }

  add(place) {
    if (!hasNumber(byId("draft-height"))) return;
    const waypoint = { ...place, altitude_m: numberIn(byId("draft-height")) };
    this.change([...this.waypoints, waypoint]);
  }

  addInTheMiddle() {
    const middle = this.page.map.middle();
    if (middle === null) {
      this.page.say("No waypoint was added: the map does not know its place before it has heard of a drone.");
      return;
    }
    this.add(middle);
    this.rows.at(-1)?.move.focus();
  }

  // Change the place or height of a waypoint; one drag is one step to undo.
  alter(index, values, isNew = true) {
    const waypoints = this.waypoints.with(index, { ...this.waypoints[index], ...values });
    if (isNew) this.change(waypoints);
    else {
      this.waypoints = waypoints;
      this.show();
    }
  }

  remove(index) {
    this.change(this.waypoints.toSpliced(index, 1));
    (this.rows[Math.min(index, this.rows.length - 1)]?.remove ?? byId("draft-add")).focus();
  }

  change(waypoints) {
    this.page.forgetLooked();
    this.past.push(this.drawn);
    this.waypoints = waypoints;
    this.show();
  }

  get drawn() {
    const [takesOff, returns] = [byId("draft-takeoff").checked, byId("draft-return").checked];
    return { waypoints: this.waypoints, takes_off: takesOff, returns };
  }

  set drawn({ waypoints, takes_off, returns }) {
    byId("draft-takeoff").checked = takes_off;
    byId("draft-return").checked = returns;
    this.waypoints = waypoints;
    this.show();
  }

  // Replace the drawn mission by a file's; undo brings it back.
  load(mission) {
    this.past.push(this.drawn);
    this.drawn = mission;
  }

  undo() {
    this.page.forgetLooked();
    this.drawn = this.past.pop();
  }

  show() {
    while (this.rows.length > this.waypoints.length) this.rows.pop().line.remove();
    while (this.rows.length < this.waypoints.length) this.rows.push(this.row(this.rows.length));
    this.waypoints.forEach((waypoint, index) => {
      for (const [name, input] of Object.entries(this.rows[index].inputs)) {
        const text = waypoint[name].toFixed(DIGITS[name]);
        if (numberIn(input) !== Number(text)) input.value = text;
        input.setCustomValidity("");
      }
    });
    byId("draft-table").hidden = this.waypoints.length === 0;
    byId("map").classList.toggle("drawing", this.isDrawing);
    this.showButtons();
    this.page.map.draw();
  }

  showButtons() {
    byId("draft-undo").disabled = this.past.length === 0;
    for (const what of ["clear", "save"]) byId(`draft-${what}`).disabled = this.waypoints.length === 0;
    byId("draft-upload").disabled = this.waypoints.length === 0 || this.page.selected.size !== 1;
  }

  row(index) {
    const of = `of waypoint ${index + 1}`;
    const inputs = Object.fromEntries(
      this.parameters.map(({ name, label, low, high }) => {
        const input = el("input", {
          ...{ type: "text", autocomplete: "off", "aria-label": `${label} ${of}`, id: `draft-${index + 1}-${name}` },
          ...{ "data-low": low, "data-high": high, inputmode: low < 0 ? "text" : "decimal" },
        });
        input.addEventListener("input", () => input.setCustomValidity(""));
        input.addEventListener("change", () => {
          if (hasNumber(input)) this.alter(index, { [name]: numberIn(input) });
        });
        return [name, input];
      }),
    );
    const move = el("button", { type: "button", "aria-label": `Move waypoint ${index + 1} by the arrow keys` }, "Move");
    move.addEventListener("keydown", (event) => this.onArrow(event, index));
    const remove = el("button", { type: "button", "aria-label": `Delete waypoint ${index + 1}` }, "Delete");
    remove.addEventListener("click", () => this.remove(index));
    const line = el(
      "tr",
      {},
      el("th", { scope: "row" }, `${index + 1}`),
      ...this.parameters.map(({ name, label }) => el("td", { "data-heading": label }, inputs[name])),
      el("td", {}, move, " ", remove),
    );
    byId("draft-rows").append(line);
    return { line, inputs, move, remove };
  }

  onArrow(event, index) {
    const way = WAYS[event.key];
    if (way === undefined) return;
    event.preventDefault();
    const { map } = this.page;
    const step = event.shiftKey ? LONG_STEP_M : STEP_M;
    const { x, y } = map.toPlace(this.waypoints[index]);
    this.alter(index, map.toDegrees({ x: x + way[0] * step, y: y + way[1] * step }), !event.repeat);
  }

  // The one selected drone, or undefined.
  get drone() {
    const [key] = this.page.selected.size === 1 ? this.page.selected : [];
    return this.page.drones.get(key);
  }

  get isRight() {
    return this.rows.every(({ inputs }) => Object.values(inputs).every(hasNumber));
  }

  mission() {
    const from = this.drone?.states.location ?? this.waypoints[0];
    const home = this.drone?.states.home ?? from;
    const at = ({ latitude_deg, longitude_deg }, altitude_m) => [0, 0, 0, null, latitude_deg, longitude_deg, altitude_m];
    const items = this.waypoints.map((waypoint) => [WAYPOINT, ABOVE_HOME, at(waypoint, waypoint.altitude_m)]);
    if (byId("draft-takeoff").checked) items.unshift([TAKEOFF, ABOVE_HOME, at(from, this.waypoints[0].altitude_m)]);
    if (byId("draft-return").checked) items.push([RETURN, WITHOUT_PLACE, [0, 0, 0, 0, 0, 0, 0]]);
    return {
      ...{ version: 2, firmwareType: PX4, vehicleType: MULTICOPTER, cruiseSpeed: 15, hoverSpeed: 5 },
      globalPlanAltitudeMode: 1,
      plannedHomePosition: [home.latitude_deg, home.longitude_deg, home.altitude_amsl_m ?? 0],
      items: items.map((parts, index) => item(index + 1, ...parts)),
    };
  }

  // Without geofence and rally points, so that the drone keeps those that it has.
  upload() {
    if (!this.isRight) return;
    const text = JSON.stringify({ fileType: "Plan", version: 1, mission: this.mission() });
    this.page.ask("upload", { name: NAME, text, to: this.page.commands.selected() });
  }

  // A file for QGroundControl has all three parts.
  save() {
    if (!this.isRight) return;
    const document = {
      ...{ fileType: "Plan", version: 1, groundStation: "MQTT-XT", mission: this.mission() },
      geoFence: { version: 2, polygons: [], circles: [] },
      rallyPoints: { version: 2, points: [] },
    };
    const file = new Blob([`${JSON.stringify(document, null, 4)}\n`], { type: "application/json" });
    if (this.saved !== undefined) URL.revokeObjectURL(this.saved);
    this.saved = URL.createObjectURL(file);
    el("a", { href: this.saved, download: NAME }).click();
  }
}
