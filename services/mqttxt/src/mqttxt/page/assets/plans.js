// Plans: a file of QGroundControl onto the selected drone, its mission started, and how far it has come.

import { byId, el } from "./dom.js";

export class Plans {
  constructor(page) {
    this.page = page;
    byId("plan-upload").addEventListener("click", () => this.upload());
    for (const what of ["start", "resume"]) {
      byId(`plan-${what}`).addEventListener("click", () => page.ask(what, { to: page.commands.selected() }));
    }
    byId("plan-file").addEventListener("change", () => this.show());
    this.show();
  }

  async upload() {
    const [file] = byId("plan-file").files;
    this.page.ask("upload", { name: file.name, text: await file.text(), to: this.page.commands.selected() });
  }

  show() {
    const isOne = this.page.selected.size === 1;
    byId("plan-upload").disabled = !isOne || byId("plan-file").files.length === 0;
    for (const what of ["start", "resume"]) byId(`plan-${what}`).disabled = !isOne;
    const flown = [...this.page.drones.values()].filter((drone) => (drone.states.mission?.total ?? 0) > 0);
    const lines = flown.map(
      ({ drone, states: { mission } }) =>
        `Drone ${drone}: item ${mission.current} of ${mission.total}, reached ${mission.reached}`,
    );
    if (lines.join("\n") === this.shown) return;
    this.shown = lines.join("\n");
    byId("plan-progress").replaceChildren(...lines.map((line) => el("li", {}, line)));
  }
}
