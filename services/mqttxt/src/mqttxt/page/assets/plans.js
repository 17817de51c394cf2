// Plans: a QGroundControl file, shown and, if the editor supports all of it, editable; its upload to the selected
// drone; the start and the progress of its mission.

import { ageMs, byId, el, named, setText } from "./dom.js";

export class Plans {
  constructor(page) {
    this.page = page;
    byId("plan-upload").addEventListener("click", () => this.upload());
    for (const what of ["start", "resume"]) {
      byId(`plan-${what}`).addEventListener("click", () => page.ask(what, { to: page.commands.selected() }));
    }
    this.path = []; // of the chosen file, until something is drawn
    this.chosen = null; // the name and text of the chosen file as it was shown: an upload sends no later text
    byId("plan-file").addEventListener("change", () => this.look());
    byId("plan-file").addEventListener("click", (event) => {
      event.target.value = ""; // else the same file, changed since, is no change
      this.look();
    });
    setInterval(() => this.show(), 1000);
    this.show();
  }

  async look() {
    this.chosen = null;
    this.show();
    this.path = [];
    setText(byId("plan-found"), "");
    this.page.map.draw();
    const [file] = byId("plan-file").files;
    if (file === undefined) return;
    const text = await file.text().catch(() => null);
    if (file !== byId("plan-file").files[0]) return; // another file was chosen meanwhile
    if (text === null) {
      this.page.say(`${file.name} cannot be read.`);
      return;
    }
    this.chosen = { name: file.name, text };
    this.show();
    this.looked = this.page.ask("look", this.chosen);
  }

  // Show the program's answer about the file that was chosen last.
  found({ number, plan }) {
    if (number !== this.looked) return;
    const [name] = [...byId("plan-file").files].map((file) => file.name);
    if (plan.draft === null) {
      setText(byId("plan-found"), `${name}: ${plan.text}. It is on the map, and cannot be changed here: ${plan.why}.`);
    } else {
      this.page.draft.load(plan.draft);
      setText(byId("plan-found"), `${name}: ${plan.text}. It is drawn below too, where it can be changed.`);
    }
    this.path = plan.path;
    this.page.map.draw();
  }

  upload() {
    this.path = [];
    this.page.ask("upload", { ...this.chosen, to: this.page.commands.selected() });
  }

  show() {
    const isOne = this.page.selected.size === 1;
    byId("plan-upload").disabled = !isOne || this.chosen === null;
    for (const what of ["start", "resume"]) byId(`plan-${what}`).disabled = !isOne;
    const flown = [...this.page.drones.values()].filter((drone) => (drone.states.mission?.total ?? 0) > 0);
    const isOld = (drone) => !drone.reachable || ageMs(drone, drone.states.mission) > this.page.staleMs;
    const lines = flown.map((drone) => {
      const { current, total, reached } = drone.states.mission;
      const old = isOld(drone) ? ": old, not of now" : "";
      return `Drone ${named(drone.fleet, drone.drone)}: item ${current} of ${total}, reached ${reached}${old}`;
    });
    if (lines.join("\n") === this.shown) return;
    this.shown = lines.join("\n");
    byId("plan-progress").replaceChildren(...lines.map((line) => el("li", {}, line)));
  }
}
