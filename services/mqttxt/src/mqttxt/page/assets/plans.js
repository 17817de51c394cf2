// Plans: a QGroundControl file, shown and, if the editor supports all of it, editable; its upload to the selected
// drone; the start and the progress of its mission.

import { byId, el, named, setText } from "./dom.js";

export class Plans {
  constructor(page) {
    this.page = page;
    byId("plan-upload").addEventListener("click", () => this.upload());
    for (const what of ["start", "resume"]) {
      byId(`plan-${what}`).addEventListener("click", () => page.ask(what, { to: page.commands.selected() }));
    }
    this.path = []; // of the chosen file, until something is drawn
    byId("plan-file").addEventListener("change", () => this.look());
    this.show();
  }

  async look() {
    this.show();
    this.path = [];
    setText(byId("plan-found"), "");
    this.page.map.draw();
    const [file] = byId("plan-file").files;
    if (file === undefined) return;
    const text = await file.text();
    if (file !== byId("plan-file").files[0]) return; // another file was chosen meanwhile
    this.looked = this.page.ask("look", { name: file.name, text });
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

  async upload() {
    this.path = [];
    const [[file], to] = [byId("plan-file").files, this.page.commands.selected()];
    this.page.ask("upload", { name: file.name, text: await file.text(), to });
  }

  show() {
    const isOne = this.page.selected.size === 1;
    byId("plan-upload").disabled = !isOne || byId("plan-file").files.length === 0;
    for (const what of ["start", "resume"]) byId(`plan-${what}`).disabled = !isOne;
    const flown = [...this.page.drones.values()].filter((drone) => (drone.states.mission?.total ?? 0) > 0);
    const lines = flown.map(
      ({ fleet, drone, states: { mission } }) =>
        `Drone ${named(fleet, drone)}: item ${mission.current} of ${mission.total}, reached ${mission.reached}`,
    );
    if (lines.join("\n") === this.shown) return;
    this.shown = lines.join("\n");
    byId("plan-progress").replaceChildren(...lines.map((line) => el("li", {}, line)));
  }
}
