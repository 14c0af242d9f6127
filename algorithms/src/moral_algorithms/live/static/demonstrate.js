/** The view in which a person shows how it is done: plays an episode, looks at it again, keeps or discards it. */

import { Refusal, request } from "./connection.js";
import { readEpisode, readThing } from "./episode.js";
import { drawBeads } from "./panel.js";
import { Player } from "./player.js";
import { Stage } from "./stage.js";
import { drawLanes, moveHead } from "./timeline.js";

/** Milliseconds that a step takes on the screen. */
const STEP_TIME = 110;
/** Keys that are remembered while a step is under way. */
const AHEAD = 2;

/** Milliseconds until a step that did not reach the server is sent again. */
const RETRY = 300;

const sleep = (milliseconds) => new Promise((resolve) => setTimeout(resolve, milliseconds));

const ARROWS = { up: "↑", down: "↓", left: "←", right: "→" };

export const HELP = [
  ["Arrow keys", "move"],
  ["W A S D", "reach up, left, down, right"],
  ["Shift + arrow", "the same"],
  ["Space", "wait"],
  ["K", "after the end: keep the episode"],
  ["X", "after the end: discard it"],
  ["Space, Home, End", "after the end: look at it again"],
];

const $ = (selector) => document.querySelector(selector);

export class Demonstrate {
  /** @param {{announce: (text: string) => void, message: (message: ?object) => void}} page */
  constructor(page) {
    this.page = page;
    this.stage = new Stage($("#left canvas"), { dashed: false, colour: "--left" });
    this.player = new Player((moment) => this.#show(moment));
    this.still = matchMedia("(prefers-reduced-motion: reduce)");
    this.play = null;
    this.ahead = [];
    this.busy = false;
    this.notice = "";
    $("#left figcaption").replaceChildren(document.createElement("output"));
    $("#play").addEventListener("click", () => this.player.toggle());
    $("#scrub").addEventListener("input", (event) => {
      this.player.jump(Number(event.target.value));
    });
    $("#keep").addEventListener("click", () => this.keep());
    $("#discard").addEventListener("click", () => this.discard());
    $("#restart").addEventListener("click", () => this.discard());
    $("#message-action").addEventListener("click", () => this.act());
  }

  update(state) {
    this.state = state;
    if (!this.pad && state.world) this.#layPad();
    if (!state.offline && !state.ended) this.#resume();
    this.#render();
  }

  drawn() {
    return {
      state: document.body.dataset.state,
      step: this.play?.step ?? null,
      playing: this.player.playing,
      frames: this.player.frames,
      left: this.stage.drawn(),
      right: null,
    };
  }

  key(event) {
    const state = document.body.dataset.state;
    const onButton = event.target.tagName === "BUTTON";
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    if (state === "playing") {
      const action = this.#actionOf(key, event.shiftKey);
      if (action === undefined || (key === " " && onButton)) return false;
      this.step(action);
      return true;
    }
    if (state === "review") {
      const scrubbing = event.target.id === "scrub";
      if (key === "k") this.keep();
      else if (key === "x") this.discard();
      else if (key === " " && !onButton) this.player.toggle();
      else if (key === "Home" && !scrubbing) this.player.jump(0);
      else if (key === "End" && !scrubbing) this.player.jump(this.player.steps);
      else return false;
      return true;
    }
    if ((state === "consent" || state === "enough") && key === "Enter" && !onButton) {
      this.act();
      return true;
    }
    return false;
  }

  #actionOf(key, shift) {
    const { keys } = this.state.demonstrations;
    const reach = `interact ${key.replace("Arrow", "").toLowerCase()}`;
    const action = shift ? this.state.world.actions.indexOf(reach) : -1;
    return action >= 0 ? action : keys[key];
  }

  /** Take a step of the episode; one that comes while another is under way waits for it. */
  async step(action) {
    if (this.ahead.length >= AHEAD) return;
    this.ahead.push(action);
    if (this.busy) return;
    this.busy = true;
    try {
      while (this.ahead.length > 0 && this.play && !this.play.over) {
        await this.#advance(this.ahead[0]);
        this.ahead.shift();
      }
      if (this.play?.over) await this.#review();
    } catch (error) {
      if (error instanceof Refusal) this.#lose(error.message);
    } finally {
      this.ahead = [];
      this.busy = false;
    }
    await this.#resume();
    this.#render();
  }

  async #advance(action) {
    const before = this.play;
    let play = null;
    while (!play) {
      try {
        play = await request(`api/plays/${before.play}/step`, { action, step: before.step });
      } catch (error) {
        // The reply to the first try was lost: the step was taken, and the server says where it led.
        if (error.code === "step") play = error.more.play;
        else if (error instanceof Refusal) throw error;
        else await sleep(RETRY);
      }
    }
    this.play = play;
    this.#extend(action);
    await this.#animate();
    this.#render();
  }

  /** Add the step that was just taken to what is drawn. */
  #extend(action) {
    const { shown, play } = this;
    const step = play.step;
    shown.cells.push(play.agent);
    shown.actions.push(action);
    shown.steps = step;
    const name = ({ kind, cell }) => `${kind} ${cell}`;
    const present = shown.things.filter(({ gone }) => gone === null);
    const [before, now] = [present, play.things].map((things) => new Set(things.map(name)));
    for (const thing of present) if (!now.has(name(thing))) thing.gone = step;
    for (const thing of play.things) {
      if (!before.has(name(thing))) shown.things.push(readThing({ ...thing, from: step }, this.state.world));
    }
  }

  async #animate() {
    const { shown, stage } = this;
    const to = shown.steps;
    stage.smooth = !this.still.matches;
    if (stage.smooth) {
      const start = performance.now();
      for (let part = 0; part < 1; ) {
        const now = await new Promise(requestAnimationFrame);
        part = Math.min(1, Math.max(0, (now - start) / STEP_TIME));
        stage.seek(to - 1 + part);
      }
    }
    stage.seek(to);
    this.#showStep(to, this.play.horizon);
  }

  async #begin() {
    this.#begun(await request("api/plays", {}));
    this.page.announce("A new episode.");
  }

  #begun(play) {
    const { world } = this.state;
    this.play = play;
    this.reviewing = false;
    this.shown = {
      ...readEpisode({ steps: 0, walls: play.walls, fixture: play.fixture, agent: [play.agent], actions: [], things: [], events: [], counters: [] }, world),
      things: play.things.map((thing) => readThing(thing, world)),
    };
    this.stage.show(this.shown);
    drawLanes($("#lanes"), [this.shown]);
    this.#showStep(0, play.horizon);
  }

  async #review() {
    const raw = await request(`api/plays/${this.play.play}/episode`);
    const episode = readEpisode(raw, this.state.world);
    this.reviewing = true;
    this.stage.smooth = !this.still.matches;
    this.stage.show(episode);
    drawLanes($("#lanes"), [episode]);
    this.player.load(episode.steps, { autoplay: false });
    this.player.seek(episode.steps);
    this.page.announce("The episode is over. Keep it or discard it.");
  }

  /** Keep the episode. */
  async keep() {
    await this.#finish("keep", "Kept.");
  }

  /** Forget the episode. */
  async discard() {
    await this.#finish("discard", "Discarded.");
  }

  async #finish(verb, notice) {
    if (this.busy || !this.play) return;
    this.busy = true;
    this.player.pause();
    try {
      const reply = await request(`api/plays/${this.play.play}/${verb}`, {});
      this.state.demonstrations = { ...this.state.demonstrations, kept: reply.kept };
      this.play = null;
      this.notice = notice;
      this.page.announce(notice);
    } catch (error) {
      if (error instanceof Refusal) {
        if (error.status === 404) this.#lose("That episode is gone. Here is a new one.");
        else this.notice = error.message;
      }
    } finally {
      this.busy = false;
    }
    await this.#resume();
    this.#render();
  }

  #lose(notice) {
    this.play = null;
    this.notice = notice;
  }

  /** Begin the next episode if none is under way and more are wanted. */
  async #resume() {
    const { state } = this;
    if (this.busy || !state.demonstrations || (state.consent && !state.consent.given)) return;
    if (this.play) {
      if (this.play.over && !this.reviewing) await this.#guarded(() => this.#review());
      return;
    }
    const { kept, wanted } = state.demonstrations;
    if (kept >= wanted && !this.more) return;
    await this.#guarded(() => this.#begin());
  }

  async #guarded(act) {
    this.busy = true;
    try {
      await act();
    } catch (error) {
      if (error instanceof Refusal) this.#lose(error.message);
    } finally {
      this.busy = false;
    }
    this.#render();
  }

  /** What the button of the message does. */
  async act() {
    const state = document.body.dataset.state;
    if (state === "consent") {
      await this.page.agree();
    } else if (state === "enough") {
      this.more = true;
      await this.#resume();
    }
  }

  #layPad() {
    this.pad = true;
    const { world, demonstrations } = this.state;
    const letters = Object.fromEntries(Object.entries(demonstrations.keys).map(([key, action]) => [action, key]));
    const pads = { move: document.createElement("div"), interact: document.createElement("div") };
    world.actions.forEach((name, action) => {
      const [verb, where] = name.split(" ");
      const button = document.createElement("button");
      button.type = "button";
      button.dataset.action = action;
      button.className = where ?? "wait";
      const key = letters[action] ?? "";
      button.textContent = verb === "wait" ? "wait" : verb === "move" ? ARROWS[where] : key.toUpperCase() || ARROWS[where];
      button.setAttribute("aria-label", verb === "interact" ? `reach ${where}` : name);
      button.addEventListener("click", () => document.body.dataset.state === "playing" && this.step(action));
      pads[verb === "interact" ? "interact" : "move"].append(button);
    });
    $("#pads").replaceChildren(
      ...Object.entries(pads)
        .filter(([, pad]) => pad.childElementCount > 0)
        .map(([verb, pad]) => {
          pad.className = "pad";
          const group = document.createElement("div");
          const title = document.createElement("p");
          title.textContent = verb === "move" ? "Move" : "Reach";
          group.append(title, pad);
          return group;
        }),
    );
  }

  #show(moment) {
    if (!this.reviewing) return;
    const { player } = this;
    this.stage.seek(moment);
    this.#showStep(moment, player.steps);
    const mode = player.playing ? "pause" : moment >= player.steps ? "again" : "play";
    $("#play").dataset.mode = mode;
    $("#play").setAttribute("aria-label", { pause: "Pause", again: "Play again", play: "Play" }[mode]);
  }

  #showStep(moment, steps) {
    const step = Math.floor(moment + 1e-9);
    moveHead($("#lanes"), moment, steps);
    const scrub = $("#scrub");
    scrub.max = steps;
    scrub.value = moment;
    scrub.setAttribute("aria-valuetext", `step ${step} of ${steps}`);
    $("#step").textContent = `${step} / ${steps}`;
  }

  #stateName() {
    const { state } = this;
    if (state.ended) return "ended";
    if (state.offline) return "disconnected";
    if (state.consent && !state.consent.given) return "consent";
    if (this.play) return this.play.over && this.reviewing ? "review" : "playing";
    const { kept, wanted } = state.demonstrations;
    return kept >= wanted && !this.more ? "enough" : "connecting";
  }

  #render() {
    const { state, play } = this;
    if (!state.demonstrations) return;
    const name = this.#stateName();
    document.body.dataset.state = name;
    document.body.toggleAttribute("data-shown", play !== null && !["ended", "consent"].includes(name));
    const { kept, wanted, instruction } = state.demonstrations;
    $("#question").textContent = name === "review" ? "Keep this episode?" : "Show how it is done";
    $("#instructions").textContent = instruction;
    $("#notice").textContent = name === "disconnected" ? "The connection is lost. This page reconnects by itself." : this.notice;
    const left = play ? play.horizon - play.step : 0;
    $("#left figcaption output").textContent = left > 0 ? `${left} ${left === 1 ? "step" : "steps"} left` : "The end";
    $("#kept").textContent = kept;
    $("#wanted").textContent = ` of ${wanted}`;
    drawBeads($("#kept-beads"), kept, wanted);
    for (const button of document.querySelectorAll("#pads button")) button.disabled = name !== "playing";
    const verdict = name === "review";
    for (const control of ["#keep", "#discard", "#play", "#scrub"]) $(control).disabled = !verdict;
    $("#restart").disabled = name !== "playing" || play.step === 0;
    if (play && name === "playing") {
      $("#left canvas").setAttribute("aria-label", `The room. You are in row ${play.agent[0]}, column ${play.agent[1]}; ${left} steps are left.`);
    }
    this.page.message(this.#message(name));
  }

  #message(name) {
    const { kept } = this.state.demonstrations;
    switch (name) {
      case "connecting":
        return { title: "One moment, please", busy: true };
      case "disconnected":
        return this.play ? null : { title: "The connection is lost", detail: "This page reconnects by itself.", busy: true };
      case "ended":
        return { title: "This session has ended", detail: "To go on, open the link that the new session printed." };
      case "consent":
        return { title: "Before you begin", detail: this.state.consent.text, action: "I agree: begin" };
      case "enough":
        return {
          title: "Thank you, that is all",
          detail: `${kept} episodes are kept. You can close this page, or play more.`,
          action: "Play one more",
          done: true,
        };
      default:
        return null;
    }
  }
}
