// Commands: their addressees and parameters, the sent ones and every word about them.

import { byId, el, hasNumber, named, numberIn, seconds, setText } from "./dom.js";
import { holder } from "./fleet.js";
import { metresBetween } from "./map.js";

const TITLES = { arm: "Arm", takeoff: "Take off", goto: "Go to", hold: "Hold", land: "Land", return: "Return", pause: "Pause mission" };
const TWO_NUMBERS = /^[\s(]*([-+]?\d+\.\d+)[,;\s]\s*([-+]?\d+\.\d+)[\s)]*$/;
const ONE_ALONE = "; Go to takes one drone";
const GOOD = ["accepted", "in_progress", "completed", "choice"];
const MOST_NAMED = 8;
const KEYS = { h: "hold", l: "land", r: "return" };
const SAFETY = Object.values(KEYS); // always in sight

export class Commands {
  constructor(page) {
    this.page = page;
    this.target = "selected";
    this.forms = new Map();
    this.orders = new Map();
    byId("take-over").addEventListener("click", () => page.ask("take_over", { to: this.selected() }));
    document.addEventListener("keydown", (event) => this.onKey(event));
    setInterval(() => this.tick(), 250);
  }

  build({ commands, ttl_s, longest_ttl_s }) {
    const offered = JSON.stringify([commands, ttl_s, longest_ttl_s]);
    if (offered === this.offered) return; // the program is back: typed text and focus stay
    this.offered = offered;
    this.catalogue = commands;
    byId("ttl").value = ttl_s;
    byId("ttl").dataset.high = longest_ttl_s;
    this.forms.clear();
    const forms = Object.entries(commands).map(([name, command]) => [name, this.form(name, command)]);
    const those = (isSafety) => forms.filter(([name]) => SAFETY.includes(name) === isSafety).map(([, form]) => form);
    byId("safety-commands").replaceChildren(...those(true));
    byId("commands").replaceChildren(...those(false));
    this.forms.get("goto").form.before(this.page.places.form);
    this.page.forgetFound();
    this.showTargets();
    this.showPlace();
  }

  form(name, command) {
    const inputs = command.parameters.map((parameter) => {
      const id = `${name}-${parameter.name}`;
      const input = el("input", {
        ...{ id, type: "text", name: parameter.name, autocomplete: "off", value: parameter.default },
        ...{ "data-low": parameter.low, "data-high": parameter.high },
        inputmode: parameter.low < 0 ? "text" : "decimal", // a phone's decimal keypad has no minus
      });
      const unit = `${parameter.unit}, ${parameter.low} to ${parameter.high}`;
      return el("p", { class: "field" }, el("label", { for: id }, parameter.label), input, el("span", {}, unit));
    });
    const button = el("button", { type: "submit", id: `send-${name}` }, TITLES[name]);
    const distance = command.best ? [el("p", { id: `${name}-distance`, class: "hint" })] : [];
    const form = el("form", { class: inputs.length ? "with-fields" : null, novalidate: true }, ...inputs, button, ...distance);
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      this.send(name);
    });
    form.addEventListener("input", (event) => {
      event.target.setCustomValidity("");
      this.showPlace();
    });
    form.addEventListener("keydown", (event) => {
      if (event.key === "Enter" && button.disabled) this.send(name); // else the browser ignores the key silently
    });
    form.addEventListener("change", () => this.page.findPlace());
    form.addEventListener("paste", (event) => this.onPaste(event));
    this.forms.set(name, { form, button });
    return form;
  }

  showTargets() {
    const fogs = this.page.fogs.map((fog) => fog.fog).join();
    if (fogs === this.shownFogs) return; // new buttons would lose the focus
    this.shownFogs = fogs;
    const choices = [["selected", "the selected drones"]];
    for (const fog of this.page.fogs) choices.push([`fog-${fog.fog}`, `all drones of fog ${fog.fog}`]);
    if (this.page.fogs.length > 1) choices.push(["all", "all drones"]);
    choices.push(["best", "whoever arrives first (Go to)"]);
    const radios = choices.map(([value, text]) => {
      const radio = el("input", { type: "radio", name: "target", value, id: `to-${value}` });
      radio.checked = value === this.target;
      radio.addEventListener("change", () => {
        this.target = value;
        this.showWho();
      });
      return el("label", { for: `to-${value}` }, radio, ` ${text}`);
    });
    byId("targets").replaceChildren(el("legend", {}, "To"), ...radios);
    this.showWho();
  }

  selected() {
    const selected = [...this.page.selected].map((key) => this.page.drones.get(key));
    return { drones: selected.map(({ fog, drone }) => [fog, drone]) };
  }

  to() {
    const fogs = this.page.fogs.map((fog) => fog.fog);
    if (this.target === "selected") return this.selected();
    if (this.target === "best") return { best: fogs };
    return { fogs: this.target === "all" ? fogs : fogs.filter((fog) => `fog-${fog}` === this.target) };
  }

  showWho() {
    const to = this.to();
    const count = to.drones?.length ?? 0;
    const names = this.page.fleet.inOrder(this.page.selected).map(({ fleet, drone }) => named(fleet, drone));
    const fogs = (to.fogs ?? to.best ?? []).join(", ");
    const drones = count === 0 ? "Nobody: select a drone" : `Drone ${names.join(", ")}${count > 1 ? ONE_ALONE : ""}`;
    const more = this.page.selected.size > 0 ? ", not the selected alone" : "";
    const all = `All drones of fog ${fogs}${more}${ONE_ALONE}`;
    const others = to.best ? `Whoever arrives first of fog ${fogs}: Go to alone` : all;
    setText(byId("who"), to.drones ? drones : others);
    setText(byId("safety-who"), byId("who").textContent.replace(ONE_ALONE, ""));
    this.fillHeight();
    this.showHolders();
    this.showDistance();
    byId("take-over").disabled = this.page.selected.size === 0;
    for (const [name, { button }] of this.forms) button.disabled = this.whyNot(name) !== null;
    if (this.page.said === this.refusal) this.page.say("");
  }

  // The holders of addressed drones that this station does not control: those drones would refuse.
  showHolders() {
    const to = this.to();
    const isMeant = this.target === "selected"
      ? (drone, key) => this.page.selected.has(key)
      : ({ fog }) => (to.fogs ?? to.best).includes(fog);
    const names = new Map();
    for (const [key, drone] of this.page.drones) {
      if (drone.mine || !drone.reachable || !isMeant(drone, key)) continue;
      const who = holder(drone, this.page);
      names.set(who, [...(names.get(who) ?? []), named(drone.fleet, drone.drone)]);
    }
    const which = (drones) => (drones.length > MOST_NAMED ? `${drones.length} of these drones` : `drone ${drones.join(", ")}`);
    const texts = [...names].map(([who, drones]) => `${who} controls ${which(drones)}`);
    const advice = this.target === "selected" ? ": take control first" : "";
    setText(byId("holders"), texts.length > 0 ? `${texts.join(", ")}${advice}` : "");
  }

  // Why a command cannot go to the chosen addressees; null if it can.
  whyNot(name) {
    const to = this.to();
    const { each, best } = this.catalogue[name];
    if (to.drones?.length === 0) return "select a drone first";
    if (to.best) return best ? null : "only Go to is for whoever arrives first";
    return each && to.drones?.length !== 1 ? "it takes one drone" : null;
  }

  send(name) {
    const { form } = this.forms.get(name);
    const why = this.whyNot(name);
    if (why !== null) {
      this.refusal = `${TITLES[name]} was not sent: ${why}.`;
      this.page.say(this.refusal);
      return;
    }
    const inputs = [...form.querySelectorAll("input")];
    if (![...inputs, byId("ttl")].every(hasNumber)) return;
    const parameters = Object.fromEntries(inputs.map((input) => [input.name, numberIn(input)]));
    this.page.ask("command", { command: name, parameters, to: this.to(), ttl_s: numberIn(byId("ttl")) });
  }

  onKey(event) {
    if (event.key === "Enter" && event.repeat) event.preventDefault(); // it would press the button again
    const isTyping = event.target.matches?.('input:not([type="checkbox"], [type="radio"])');
    const hasModifier = event.ctrlKey || event.altKey || event.metaKey;
    const name = KEYS[event.key.toLowerCase()];
    if (isTyping || hasModifier || event.repeat || name === undefined) return;
    if (byId("keys").checked && this.forms.has(name)) this.send(name);
  }

  choosePlace(place) {
    for (const [field, value] of Object.entries(place)) byId(`goto-${field}`).value = value.toFixed(7);
    this.fillHeight();
    this.page.forgetFound();
    this.showPlace();
  }

  // Fill in the height of a place that has none, also if the drone is selected after the place.
  fillHeight() {
    const input = byId("goto-altitude_m");
    if (input.value === "" && byId("goto-latitude_deg").value !== "") input.value = this.likelyHeight();
  }

  // The likely height for the one selected drone: its present height in the air, its takeoff height before.
  likelyHeight() {
    if (this.page.selected.size !== 1) return "";
    const { landed_state, location } = this.page.drones.get([...this.page.selected][0]).states;
    const isInAir = landed_state?.landed === "in_air" && location !== undefined;
    return isInAir ? Math.round(location.altitude_m) : byId("takeoff-altitude_m").value;
  }

  showPlace() {
    const [latitude_deg, longitude_deg] = ["latitude_deg", "longitude_deg"].map(
      (field) => numberIn(byId(`goto-${field}`)),
    );
    this.page.showPlace(Number.isNaN(latitude_deg + longitude_deg) ? null : { latitude_deg, longitude_deg });
    this.showDistance();
  }

  // The place's name and its distance from the drone, which reveals swapped numbers.
  showDistance() {
    const [key] = this.page.selected.size === 1 && this.target === "selected" ? this.page.selected : [];
    const drone = this.page.drones.get(key);
    const from = drone?.states.location;
    const metres = from === undefined || this.page.place === null ? null : metresBetween(from, this.page.place);
    const shown = metres < 10000 ? `${Math.round(metres)} m` : `${Math.round(metres / 1000)} km`;
    const far = metres === null ? null : `${shown} from drone ${named(drone.fleet, drone.drone)}`;
    const name = this.page.places.nameOf(this.page.place);
    setText(byId("goto-distance"), [name, far].filter(Boolean).join(", "));
    byId("map-goto").hidden = this.page.place === null;
    setText(byId("map-place"), [name ?? "the place", far].filter(Boolean).join(", "));
  }

  // A pasted pair of numbers, as maps copy a place, fills in both fields.
  onPaste(event) {
    const pasted = TWO_NUMBERS.exec(event.clipboardData.getData("text"));
    if (pasted === null || !event.target.name.endsWith("_deg")) return;
    event.preventDefault();
    [byId("goto-latitude_deg").value, byId("goto-longitude_deg").value] = pasted.slice(1);
    this.showPlace();
    this.page.findPlace();
  }

  update(order, at) {
    let shown = this.orders.get(order.number);
    if (shown === undefined) {
      shown = { left: el("p", { class: "left" }), words: el("ol"), line: null };
      shown.line = el("li", { "data-order": order.number }, el("h3", {}, order.text), shown.left, shown.words);
      byId("orders").prepend(shown.line);
      this.orders.set(order.number, shown);
    }
    shown.order = { ...order, at };
    for (const word of order.words.slice(shown.words.children.length)) {
      const text = el("strong", { class: `word ${word.word.replaceAll(" ", "-")}`, title: word.code }, word.text);
      shown.words.append(el("li", { "data-word": word.word }, text, " ", word.plain));
    }
    shown.line.classList.toggle("open", order.open);
    this.showLeft(shown);
    this.showNewest();
  }

  // Beside the buttons: the newest command with its words, how many drones gave each, and the reason of a failure.
  showNewest() {
    const { order } = this.orders.get(Math.max(...this.orders.keys()));
    const counts = new Map();
    for (const { word } of order.words) counts.set(word, (counts.get(word) ?? 0) + 1);
    const words = [...counts].map(([word, count]) => `${word.replaceAll("_", " ")}${count > 1 ? ` ${count}` : ""}`);
    const bad = order.words.findLast(({ word }) => !GOOD.includes(word));
    const why = bad === undefined ? [] : [bad.plain || bad.text];
    setText(byId("newest"), [`${order.text}: ${words.join(", ") || "sent"}`, ...why].join(". "));
    byId("newest").classList.toggle("bad", bad !== undefined);
  }

  showLeft({ order, left }) {
    const since = performance.now() - order.at;
    const [start, end] = [order.start_left_ms - since, order.end_left_ms - since];
    const hasBegun = order.words.some((word) => ["accepted", "in_progress"].includes(word.word));
    let text = "";
    if (order.open && !hasBegun && start > 0) text = `${seconds(start)} s left to start`;
    else if (order.open && end > 0) text = `${seconds(end)} s left to end`;
    else if (order.open) text = "waiting for the last word";
    setText(left, [order.open ? order.progress : null, text].filter(Boolean).join("; "));
  }

  tick() {
    for (const shown of this.orders.values()) if (shown.order.open) this.showLeft(shown);
  }

  goals() {
    return [...this.orders.values()].map(({ order }) => order).filter((order) => order.open && order.goal !== null)
      .map((order) => order.goal);
  }

  // The path of the newest upload that was completed.
  path() {
    const uploads = [...this.orders.values()].map(({ order }) => order).filter((order) => order.path !== null);
    return uploads.findLast((order) => order.words.some((word) => word.word === "completed"))?.path ?? [];
  }

  clear() {
    this.orders.clear();
    byId("orders").replaceChildren();
    setText(byId("newest"), "");
  }
}
