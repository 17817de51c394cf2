// The page: one socket to its server, and the parts that show its updates.

import { Commands } from "./commands.js";
import { byId, keyOf, named, setText } from "./dom.js";
import { Draft } from "./draft.js";
import { Fleet } from "./fleet.js";
import { Links } from "./links.js";
import { Log } from "./log.js";
import { FleetMap } from "./map.js";
import { Places } from "./places.js";
import { Plans } from "./plans.js";
import { showRankings } from "./rankings.js";
import { Sensors } from "./sensors.js";

const AGAIN_MS = 1000;
const SILENT_MS = 5000; // the program sends an update each second
const MOST_SILENT = 10;
const MADE_UP = /^gs-[0-9a-f]{8}$/; // the name of a station without identity: another one at each start
const CONNECTED = "connected to the page's program";
const GONE = "The page's program does not answer. What is shown is old. Trying again …";

class Page {
  constructor() {
    this.drones = new Map();
    this.selected = new Set();
    this.lost = new Map();
    this.fogs = [];
    this.names = {}; // the names of this page's station, by fleet
    this.staleMs = Infinity;
    this.place = null;
    this.found = null; // a typed place, which the map includes in its view
    this.asked = 0;
    this.unanswered = new Map(); // what was asked of drones, by its number
    this.ahead = -Infinity; // of the program's clock over the page's, ms: a lower bound, as updates take time
    this.fleet = new Fleet(this);
    this.places = new Places(this);
    this.map = new FleetMap(this);
    this.commands = new Commands(this);
    this.log = new Log();
    this.draft = new Draft(this);
    this.plans = new Plans(this);
    this.sensors = new Sensors();
    this.links = new Links(this);
    const notice = byId("notice"); // its height shifts what is fixed above it
    new ResizeObserver(() => {
      document.documentElement.style.setProperty("--notice", `${notice.offsetHeight}px`);
    }).observe(notice);
    this.connect();
    setInterval(() => this.checkHeard(), 1000);
  }

  connect() {
    this.socket = new WebSocket(`ws://${location.host}/live`);
    this.ahead = -Infinity;
    this.silent = 0;
    this.socket.addEventListener("message", (event) => this.hear(JSON.parse(event.data)));
    this.socket.addEventListener("open", () => {
      this.heard = performance.now();
      this.showConnection(CONNECTED, true);
    });
    this.socket.addEventListener("close", () => {
      this.showConnection(GONE, false);
      this.sayUnanswered();
      setTimeout(() => this.connect(), AGAIN_MS);
    });
  }

  // A program or a tunnel that hangs closes no connection. A new one compares the clocks anew: if the program's stood
  // still with its machine, or is slower than the page's, all that comes on the old one looks late for good.
  checkHeard() {
    if (this.socket.readyState !== WebSocket.OPEN) return;
    const isCurrent = performance.now() - this.heard < SILENT_MS;
    this.showConnection(isCurrent ? CONNECTED : GONE, isCurrent);
    this.silent = isCurrent ? 0 : this.silent + 1;
    if (this.silent > MOST_SILENT) this.socket.close();
  }

  showConnection(text, isConnected) {
    setText(byId("connection"), text);
    document.body.classList.toggle("disconnected", !isConnected);
    this.gone = isConnected ? "" : text;
    this.showNotice();
  }

  hear(update) {
    this.ahead = Math.max(this.ahead, update.at_ms - performance.now());
    if (update.hello) this.begin(update.hello);
    if (update.fogs) this.showFogs(update.fogs);
    const at = update.at_ms - this.ahead; // when it was sent, by the page's time: it may have waited on its way
    this.heard = at;
    if (update.hello) this.doubtOthers(update.drones ?? []);
    if (update.drones) this.hearDrones(update.drones, at);
    for (const order of update.orders ?? []) this.commands.update(order, at);
    for (const answer of update.answers ?? []) this.hearAnswer(answer);
    if (update.orders) this.map.draw();
    if (update.links) this.links.update(update.links);
    if (update.rankings) showRankings(update.rankings);
    for (const chart of update.sensors ?? []) this.sensors.update(chart);
    if (update.drones) this.plans.show();
    if (update.drones && this.canCommand) {
      this.commands.showHolders();
      this.commands.showDistance();
    }
    if (update.log) this.log.add(update.log);
  }

  begin(hello) {
    const names = Object.values(hello.names).filter((name) => !MADE_UP.test(name));
    const whose = JSON.stringify([names, hello.prefixes, hello.brokers, hello.fogs]);
    if (this.whose !== undefined && this.whose !== whose) location.reload(); // drone 1 may be a different drone now
    this.whose = whose;
    this.names = hello.names;
    this.fleet.begin(Object.keys(hello.names).length > 1);
    this.staleMs = hello.stale_ms;
    this.canCommand = !hello.watch_only;
    setText(byId("station"), hello.watch_only ? `${hello.station}, which only watches` : hello.station);
    document.body.classList.toggle("watch-only", hello.watch_only);
    this.lost.clear();
    this.showLost();
    this.links.begin(hello.links);
    this.log.clear();
    this.sensors.clear();
    this.commands.clear();
    this.map.tiles.begin(hello.tiles);
    this.places.begin(hello.places);
    if (!this.canCommand) return;
    this.commands.build(hello);
    this.draft.build(hello);
  }

  showFogs(fogs) {
    this.fogs = fogs;
    setText(byId("fogs"), fogs.map((fog) => `Fog ${fog.fog}: ${fog.live ? "heard" : "NOT HEARD"}`).join(", "));
    document.body.classList.toggle("one-fog", fogs.length === 1);
    byId("fogs").classList.toggle("bad", fogs.some((fog) => !fog.live));
    if (this.canCommand) this.commands.showTargets();
  }

  hearDrones(drones, at) {
    let hasChanged = false;
    for (const drone of drones) {
      const key = keyOf(drone);
      const wasMine = this.drones.get(key)?.mine;
      drone.at = at;
      this.drones.set(key, drone);
      this.fleet.update(drone);
      this.map.update(drone);
      const hadIt = this.lost.get(key);
      if (drone.mine) this.lost.delete(key);
      else if (wasMine || hadIt !== undefined) this.lost.set(key, drone.holder ?? "nobody");
      hasChanged = hasChanged || this.lost.get(key) !== hadIt;
    }
    if (hasChanged) this.showLost();
  }

  // A program that came back may not know a drone that the one before knew: who reaches and controls it is not known.
  doubtOthers(drones) {
    const known = new Set(drones.map(keyOf));
    for (const [key, drone] of this.drones) {
      if (known.has(key)) continue;
      Object.assign(drone, { reachable: false, mine: false, holder: null });
      this.fleet.update(drone);
      this.map.update(drone);
    }
  }

  // Show which drones other stations have taken, until they are back.
  showLost() {
    const names = new Map();
    for (const [key, holder] of this.lost) {
      const { fleet, drone } = this.drones.get(key);
      names.set(holder, [...(names.get(holder) ?? []), named(fleet, drone)]);
    }
    const texts = [...names].map(([holder, of]) => `Control of drone ${of.join(", ")} is lost: ${holder} has it.`);
    this.lostText = texts.join(" ");
    this.showNotice();
  }

  select(keys) {
    this.selected = new Set(keys);
    this.fleet.mark(this.selected);
    if (this.canCommand) this.commands.showWho();
    this.plans.show();
    this.draft.showButtons();
    this.map.mark(this.selected);
  }

  toggle(key) {
    const keys = new Set(this.selected);
    if (!keys.delete(key)) keys.add(key);
    this.select(keys);
  }

  choosePlace(place) {
    if (this.canCommand) this.commands.choosePlace(place);
  }

  showPlace(place) {
    this.place = place;
    this.places.show();
    this.map.draw();
  }

  findPlace() {
    this.found = this.place;
    this.map.draw();
  }

  forgetFound() {
    this.found = null;
  }

  goals() {
    return this.commands.goals();
  }

  path() {
    return this.plans.path.length > 0 ? this.plans.path : this.commands.path();
  }

  forgetLooked() {
    this.plans.path = [];
  }

  // The path of a chosen plan file, which the map shows.
  looked() {
    return this.plans.path;
  }

  isDrawing() {
    return this.draft.isDrawing;
  }

  drawn() {
    return this.draft.waypoints;
  }

  addWaypoint(place) {
    this.draft.add(place);
  }

  moveWaypoint(index, place, isNew) {
    this.draft.alter(index, place, isNew);
  }

  // Send a request; returns its number, undefined without a connection. It carries the time by the program's clock,
  // never a later one, so that a request that is delayed on its way gains no time.
  ask(what, more) {
    if (this.socket.readyState !== WebSocket.OPEN || this.ahead === -Infinity) {
      this.say("Not sent: the page's program does not answer.");
      return undefined;
    }
    this.say("");
    this.asked += 1;
    if (!["look", "link"].includes(what)) this.unanswered.set(this.asked, more.command ?? what.replaceAll("_", " "));
    this.socket.send(JSON.stringify({ number: this.asked, do: what, at_ms: performance.now() + this.ahead, ...more }));
    return this.asked;
  }

  // An error stays until the next request: the answer to one that was asked beside it does not hide it.
  hearAnswer(answer) {
    this.unanswered.delete(answer.number);
    if (answer.error && !this.said?.includes(answer.error)) {
      this.say([this.said, answer.error].filter(Boolean).join(" "));
    }
    if (answer.plan) this.plans.found(answer);
  }

  // The connection ended before the answer came: the program may have carried the request out.
  sayUnanswered() {
    if (this.unanswered.size === 0) return;
    const what = [...this.unanswered.values()].join(", ");
    this.unanswered.clear();
    this.say(`No answer came to ${what}: nobody knows whether it was sent. Look at the drone before you command it again.`);
  }

  // Show the newest answer, beside a notice of lost control.
  say(text) {
    this.said = text;
    this.showNotice();
  }

  showNotice() {
    setText(byId("notice"), [this.gone, this.lostText, this.said].filter(Boolean).join(" "));
  }
}

new Page();
