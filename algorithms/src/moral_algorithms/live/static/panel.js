/** Beside the question: how far the person is, what has been learned of the weights, and the agent. */

import { drawCurves, drawPosterior } from "./charts.js";
import { request } from "./connection.js";
import { readEpisode } from "./episode.js";
import { Stage } from "./stage.js";

/** More wanted answers than this are a bar and no beads. */
const MOST_BEADS = 60;
/** Milliseconds a step of the agent's latest episode is shown, and its end. */
const STEP_TIME = 120;
const END_TIME = 2_000;
/** Charts are drawn at most once in so many milliseconds. */
const DRAW_TIME = 250;
/** Expected regret that is worth a question where the server names none. */
const WORTH_ASKING = 0.005;

const $ = (selector) => document.querySelector(selector);

export class Panel {
  constructor() {
    this.stage = new Stage($("#latest"), { dashed: false, colour: "--agent" });
    this.stage.smooth = false;
    this.still = matchMedia("(prefers-reduced-motion: reduce)");
    this.due = null;
    this.looping = false;
  }

  update(state) {
    this.state = state;
    this.due ??= setTimeout(() => {
      this.due = null;
      this.#draw();
    }, this.drawn ? DRAW_TIME : 0);
    if (!this.looping && state.status && !state.offline) this.#loop();
  }

  #draw() {
    const { status, queue, curves, world, names } = this.state;
    this.drawn = true;
    if (queue) {
      drawBeads($("#beads"), queue.answered, queue.queries);
      $("#answered").textContent = queue.answered;
      $("#of").textContent = ` of ${queue.queries}`;
      drawTeaching($("#teach"), queue.open[0]?.expected ?? null, status?.advice?.threshold ?? null);
    }
    if (status?.samples?.length > 0) {
      const read = status.components.map((component) => names?.[component] ?? component);
      drawPosterior($("#posterior"), read, status.samples, status.weights);
    }
    if (curves) drawCurves($("#curves"), world.objectives, curves);
    if (status) {
      const percent = Math.round(100 * status.progress);
      $("#trained").textContent = {
        preparing: `getting ready, ${percent} %`,
        training: `${percent} % trained`,
        resting: `${percent} % trained, resting until your next answer`,
        closing: `${percent} % trained`,
        finished: "trained",
      }[status.phase];
    }
  }

  /** Play the agent's latest episode, then the next, for as long as there is a connection. */
  async #loop() {
    this.looping = true;
    while (!this.state.offline && !this.state.ended) {
      try {
        const { episode } = await request("api/episode");
        await this.#play(readEpisode(episode, this.state.world));
      } catch {
        await sleep(END_TIME);
      }
    }
    this.looping = false;
  }

  async #play(episode) {
    this.stage.show(episode);
    if (this.still.matches) {
      this.stage.seek(episode.steps);
      await sleep(2 * END_TIME);
      return;
    }
    for (let step = 0; step <= episode.steps; step += 1) {
      this.stage.seek(step);
      await sleep(STEP_TIME);
      while (document.hidden) await sleep(END_TIME);
    }
    await sleep(END_TIME);
  }
}

const sleep = (milliseconds) => new Promise((resolve) => setTimeout(resolve, milliseconds));

/** Draw a bead for each that is wanted, filled for each that is there. */
export function drawBeads(box, there, wanted) {
  const key = `${there} ${wanted}`;
  if (box.dataset.key === key) return;
  box.dataset.key = key;
  const bar = wanted > MOST_BEADS;
  box.classList.toggle("bar", bar);
  box.replaceChildren(
    ...Array.from({ length: bar ? 1 : Math.max(wanted, there) }, (_, i) => {
      const bead = document.createElement("i");
      if (bar) bead.style.width = `${Math.min(100, (100 * there) / wanted)}%`;
      bead.className = bar || i < there ? "there" : "";
      return bead;
    }),
  );
}

/** Say how much the next answer should teach, against what is worth a question at all. */
function drawTeaching(box, expected, threshold) {
  const ratio = expected === null ? 0 : expected / (threshold ?? WORTH_ASKING);
  const words = expected === null ? "–" : ratio >= 8 ? "a lot" : ratio >= 2 ? "something" : "little";
  box.querySelector("output").textContent = words;
  box.querySelector("i").style.width = `${Math.round(100 * Math.min(1, Math.log2(1 + ratio) / 5))}%`;
  box.title = expected === null ? "" : `Expected regret without this answer: ${expected.toPrecision(2)}`;
}
