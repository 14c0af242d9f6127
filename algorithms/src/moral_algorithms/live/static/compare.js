/** The view in which a person compares two episodes. */

import { Refusal, drawKey, newerQueue, request } from "./connection.js";
import { describe, plain, readEpisode } from "./episode.js";
import { Player } from "./player.js";
import { Stage } from "./stage.js";
import { drawLanes, moveHead } from "./timeline.js";
import { Stopwatch } from "./stopwatch.js";

const PREFERENCES = { left: "first", right: "second", equal: "equal", unsure: "cannot_tell" };
const SPOKEN = {
  first: "Left is better",
  second: "Right is better",
  equal: "Equally good",
  cannot_tell: "Cannot tell",
};

const KEYS = {
  ArrowLeft: "left", 1: "left",
  ArrowRight: "right", 2: "right",
  ArrowDown: "equal", e: "equal", 3: "equal",
  x: "unsure", 4: "unsure",
};

/** How long the person sees which answer was recorded, in milliseconds. */
const ACKNOWLEDGE = 450;
/** A declined offer to stop comes again after so many more answers. */
const OFFER_AGAIN = 5;
/** Questions that are kept ready. */
const READY = 2;

export const HELP = [
  ["← or 1", "the left one is better"],
  ["→ or 2", "the right one is better"],
  ["↓ or 3", "both are equally good"],
  ["X or 4", "I cannot tell"],
  ["U or Backspace", "take the last answer back"],
  ["Space", "play or pause"],
  [", and .", "one step back or on"],
  ["Home and End", "to the start or the end"],
  ["S", "change the speed"],
  ["C", "show or hide counts"],
];

const $ = (selector) => document.querySelector(selector);

export class Compare {
  /** @param {{announce: (text: string) => void}} page */
  constructor(page) {
    this.page = page;
    this.question = null;
    this.sent = null;
    this.acknowledged = null;
    this.undone = null;
    this.checking = null;
    this.busy = false;
    this.notice = "";
    this.offerFrom = 0;
    this.cache = new Map();
    this.watch = new Stopwatch();
    this.stages = [
      new Stage($("#left canvas"), { dashed: false, colour: "--left" }),
      new Stage($("#right canvas"), { dashed: true, colour: "--right" }),
    ];
    this.player = new Player((moment) => this.#show(moment));
    const still = matchMedia("(prefers-reduced-motion: reduce)");
    const obey = () => this.stages.forEach((stage) => (stage.smooth = !still.matches));
    still.addEventListener("change", obey);
    obey();
    this.still = still;

    for (const button of document.querySelectorAll("[data-answer]")) {
      button.addEventListener("click", () => this.answer(PREFERENCES[button.dataset.answer]));
    }
    $("#undo").addEventListener("click", () => this.undo());
    $("#play").addEventListener("click", () => this.player.toggle());
    $("#speed").addEventListener("click", () => this.#nextSpeed());
    $("#counts").addEventListener("click", () => this.#toggleCounts());
    $("#stop").addEventListener("click", () => this.stop());
    $("#go-on").addEventListener("click", () => this.goOn());
    $("#message-action").addEventListener("click", () => this.act());
    $("#scrub").addEventListener("input", (event) => {
      this.player.jump(Number(event.target.value));
    });
  }

  /** Take what the server said; `state` is the protocol's State, with `offline` and `ended` beside it. */
  update(state) {
    this.state = state;
    if (state.queue && this.question && !this.sent) this.#checkQuestion();
    if (state.offline) this.checking = null;
    else this.#resume();
    this.#render();
  }

  /** What is drawn on each side, the moment that is shown, and what the page waits for. */
  drawn() {
    const [left, right] = this.stages.map((stage) => stage.drawn());
    return {
      state: document.body.dataset.state,
      query: this.question?.query ?? null,
      playing: this.player.playing,
      frames: this.player.frames,
      left,
      right,
    };
  }

  /** @returns {boolean} Whether the key was one of this view's. */
  key(event) {
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    const scrubbing = event.target.id === "scrub";
    if (key in KEYS && !(scrubbing && key.startsWith("Arrow"))) {
      if (!event.repeat) this.answer(PREFERENCES[KEYS[key]]);
    } else if (key === " " && event.target.tagName !== "BUTTON") {
      this.player.toggle();
    } else if (key === "u" || key === "Backspace") {
      if (!event.repeat) this.undo();
    } else if (key === ",") this.player.step(-1);
    else if (key === ".") this.player.step(1);
    else if (key === "Home" && !scrubbing) this.player.jump(0);
    else if (key === "End" && !scrubbing) this.player.jump(this.player.steps);
    else if (key === "s") this.#nextSpeed();
    else if (key === "c") this.#toggleCounts();
    else if (key === "f" && !$("#offer").hidden) this.stop();
    else if (key === "g" && !$("#offer").hidden) this.goOn();
    else if (key === "Enter" && event.target.tagName !== "BUTTON" && document.body.dataset.state === "consent") this.act();
    else return false;
    return true;
  }

  /** Answer the question that is shown. */
  async answer(preference) {
    if (document.body.dataset.state !== "question") return;
    const seconds = this.watch.read();
    this.sent = { query: this.question.query, preference, seconds, key: drawKey(), since: performance.now() };
    this.notice = "";
    this.#render();
    await this.#send();
  }

  async #send() {
    if (this.busy) return;
    const { query, preference, seconds, key, since } = this.sent;
    this.busy = true;
    try {
      const reply = await request(`api/queries/${query}/answer`, { preference, seconds, key });
      performance.measure("moral: answer recorded", { start: since });
      this.state.queue = newerQueue(this.state.queue, reply.queue);
      this.page.announce(`Recorded: ${SPOKEN[preference]}.`);
      this.#acknowledge(preference);
    } catch (error) {
      if (!(error instanceof Refusal)) return; // Not reached: it is sent again, with the same key, on reconnection.
      this.sent = null;
      if (error.code === "answered") this.#drop("This question was answered in another window. Here is the next one.");
      else if (error.status === 404) this.#drop("That question is gone. Here is the next one.");
      else this.notice = error.status === 503 ? "Your answer could not be saved. Please answer again." : error.message;
    } finally {
      this.busy = false;
    }
    this.#resume();
    this.#render();
  }

  #acknowledge(preference) {
    this.sent = null;
    this.acknowledged = preference;
    this.player.pause();
    this.goingOn = setTimeout(() => {
      this.acknowledged = null;
      this.question = null;
      this.#resume();
      this.#render();
    }, ACKNOWLEDGE);
  }

  /** Take the last answer back and show its question again. */
  async undo() {
    const last = this.state?.queue?.last;
    if (!last || this.busy || this.sent || this.state.offline || this.state.status?.phase === "finished") return;
    clearTimeout(this.goingOn);
    this.acknowledged = null;
    this.busy = true;
    // Sent again after a lost reply, an undo keeps its key.
    this.undone ??= { query: last.query, key: drawKey() };
    const { query, key } = this.undone;
    try {
      const reply = await request(`api/queries/${query}/undo`, { key });
      this.state.queue = newerQueue(this.state.queue, reply.queue);
      this.undone = null;
      this.question = null;
      await this.#load(query);
      this.notice = "Your last answer is taken back. Please answer this question again.";
      this.page.announce(this.notice);
    } catch (error) {
      if (error instanceof Refusal) {
        this.undone = null;
        this.notice = error.message;
      }
    } finally {
      this.busy = false;
    }
    this.#render();
  }

  /** Ask no more. */
  async stop() {
    try {
      await request("api/stop", {});
      this.question = null;
      this.state.queue = { ...this.state.queue, stopping: true };
    } catch (error) {
      this.notice = error.message;
    }
    this.#render();
  }

  /** Decline the offer to stop, for now. */
  goOn() {
    this.offerFrom = this.state.queue.answered + OFFER_AGAIN;
    this.#render();
  }

  /** What the button of the message does: accept the notice of the study. */
  act() {
    if (document.body.dataset.state === "consent") this.page.agree();
  }

  // ---- Which question is shown --------------------------------------------------------------------------

  /** Send again what was not acknowledged, or show the next question if there is none. */
  async #resume() {
    const { state } = this;
    if (!state?.queue || state.offline || state.ended || this.busy || this.acknowledged) return;
    if (this.sent) {
      await this.#send();
      return;
    }
    if (this.question || state.queue.stopping || (state.consent && !state.consent.given)) return;
    if (["closing", "finished"].includes(state.status?.phase)) return;
    const [next] = state.queue.open;
    if (!next) return;
    this.busy = true;
    try {
      await this.#load(next.query);
    } catch {
      // The next event from the server is the next try.
    } finally {
      this.busy = false;
    }
    this.#render();
  }

  async #load(query) {
    const found = await this.#fetch(query);
    if (found.state === "answered" && !this.state.queue.open.some((open) => open.query === query)) return;
    this.question = { ...found, episodes: found.episodes.map((raw) => readEpisode(raw, this.state.world)) };
    const { episodes } = this.question;
    this.stages.forEach((stage, side) => {
      stage.show(episodes[side]);
      const name = side === 0 ? "left" : "right";
      stage.canvas.setAttribute("aria-label", `The ${name} episode. ${describe(episodes[side])}`);
    });
    const steps = Math.max(...episodes.map((episode) => episode.steps));
    $("#scrub").max = steps;
    drawLanes($("#lanes"), episodes);
    this.player.load(steps, { autoplay: !this.still.matches });
    this.watch.start();
    this.page.announce("A new question.");
    for (const { query: other } of this.state.queue.open.slice(0, READY)) this.#fetch(other).catch(() => {});
  }

  /** Contents of a query never change, so that one that was fetched ahead can be shown at once. */
  async #fetch(query) {
    if (!this.cache.has(query)) {
      if (this.cache.size > 8) this.cache.delete(this.cache.keys().next().value);
      this.cache.set(query, request(`api/queries/${query}`));
      this.cache.get(query).catch(() => this.cache.delete(query));
    }
    return this.cache.get(query);
  }

  /** Somebody else may have answered the question that is shown; a retired one still counts. */
  async #checkQuestion() {
    const { query } = this.question;
    if (this.acknowledged || this.state.queue.open.some((open) => open.query === query)) return;
    if (this.checking === query) return;
    this.checking = query;
    try {
      const { state } = await request(`api/queries/${query}`);
      if (state === "answered" && this.question?.query === query && !this.sent && !this.acknowledged) {
        this.#drop("This question was answered in another window. Here is the next one.");
        this.#resume();
        this.#render();
      } else if (state === "retired") {
        return;
      }
    } catch (error) {
      if (error instanceof Refusal && error.status === 404) this.#drop("That question is gone. Here is the next one.");
    }
    this.checking = null;
  }

  #drop(notice) {
    this.cache.delete(this.question?.query);
    this.question = null;
    this.notice = notice;
  }

  // ---- What is shown ------------------------------------------------------------------------------------

  #show(moment) {
    const { player } = this;
    this.stages.forEach((stage) => stage.seek(Math.min(moment, stage.episode?.steps ?? 0)));
    moveHead($("#lanes"), moment, player.steps);
    const scrub = $("#scrub");
    scrub.value = moment;
    const step = Math.floor(moment + 1e-9);
    if (scrub.dataset.step !== String(step)) {
      scrub.dataset.step = step;
      scrub.setAttribute("aria-valuetext", `step ${step} of ${player.steps}`);
      $("#step").textContent = `${step} / ${player.steps}`;
      this.#showCounts(step);
    }
    const mode = player.playing ? "pause" : moment >= player.steps && player.steps > 0 ? "again" : "play";
    const play = $("#play");
    if (play.dataset.mode !== mode) {
      play.dataset.mode = mode;
      play.setAttribute("aria-label", { pause: "Pause", again: "Play again", play: "Play" }[mode]);
    }
  }

  #showCounts(step) {
    const on = $("#counts").getAttribute("aria-pressed") === "true";
    ["left", "right"].forEach((side, number) => {
      const output = $(`#${side} .counts`);
      output.hidden = !on || !this.question;
      if (output.hidden) return;
      const { counters, steps } = this.question.episodes[number];
      const row = counters[Math.min(step, steps)];
      output.textContent = this.state.world.objectives.map((name, i) => `${plain(name)} ${row[i]}`).join(" · ");
    });
  }

  #toggleCounts() {
    const button = $("#counts");
    button.setAttribute("aria-pressed", button.getAttribute("aria-pressed") !== "true");
    this.#showCounts(Math.floor(this.player.moment + 1e-9));
  }

  #nextSpeed() {
    const speed = this.player.nextSpeed();
    $("#speed").textContent = speed === 0.5 ? "½×" : `${speed}×`;
    $("#speed").setAttribute("aria-label", `Speed: ${speed} times`);
  }

  #stateName() {
    const { state } = this;
    if (state?.ended) return "ended";
    if (!state?.world) return "connecting";
    if (state.offline) return "disconnected";
    if (state.consent && !state.consent.given) return "consent";
    if (state.status?.phase === "finished") return "finished";
    if (state.trainer === "failed" || state.trainer === "stopped") return "halted";
    if (this.acknowledged) return "answered";
    if (this.sent) return "sending";
    if (this.question) return "question";
    if (state.status?.phase === "closing" || state.queue?.stopping) return "closing";
    return state.status?.phase === "training" || state.status?.phase === "resting" ? "waiting" : "preparing";
  }

  #render() {
    const { state } = this;
    const name = this.#stateName();
    document.body.dataset.state = name;
    const open = name === "question";
    const chosen = this.acknowledged ?? this.sent?.preference ?? null;
    for (const button of document.querySelectorAll("[data-answer]")) {
      // Not disabled: the keyboard's place would be lost.
      button.setAttribute("aria-disabled", !open);
      button.toggleAttribute("data-chosen", PREFERENCES[button.dataset.answer] === chosen);
    }
    $("#left").toggleAttribute("data-chosen", chosen === "first" || chosen === "equal");
    $("#right").toggleAttribute("data-chosen", chosen === "second" || chosen === "equal");
    const last = state?.queue?.last;
    $("#undo").disabled = !last || name === "finished" || name === "ended" || name === "disconnected";
    document.body.toggleAttribute("data-shown", this.question !== null && !["ended", "consent", "finished"].includes(name));

    const notice = name === "disconnected" && this.question
      ? "The connection is lost. Your answers are safe; this page reconnects by itself."
      : this.notice;
    $("#notice").textContent = notice;
    const offered = open && state.status?.advice?.enough === true && state.queue.answered >= this.offerFrom;
    if (offered && $("#offer").hidden) this.page.announce("More answers would change little now. You can stop here.");
    $("#offer").hidden = !offered;
    this.page.message(this.#message(name));
  }

  #message(name) {
    const { state } = this;
    const answered = state?.queue?.answered ?? 0;
    const count = `${answered} ${answered === 1 ? "question" : "questions"}`;
    const progress = state?.status?.progress;
    switch (name) {
      case "connecting":
        return { title: "Connecting", detail: "One moment, please.", busy: true };
      case "disconnected":
        return this.question ? null : { title: "The connection is lost", detail: "Your answers are safe. This page reconnects by itself.", busy: true };
      case "ended":
        return { title: "This session has ended", detail: "To go on, open the link that the new session printed." };
      case "consent":
        return { title: "Before you begin", detail: state.consent.text, action: "I agree: begin" };
      case "preparing":
        return { title: "Getting ready", detail: "The agent takes its first steps. Your first question comes soon.", progress, busy: true };
      case "waiting":
        return { title: "The next question is on its way", detail: "The agent practises with what you have said so far.", busy: true };
      case "closing":
        return { title: "Thank you", detail: `You answered ${count}. The agent now trains with what you said.`, progress, busy: true };
      case "finished":
        return { title: "Finished", detail: `Thank you! You answered ${count}. ${achieved(state)} You can close this page.`, done: true };
      case "halted":
        return {
          title: "Training has stopped",
          detail: "Your answers are safe. Please tell the person who runs this session.",
        };
      default:
        return null;
    }
  }
}

/** What the trained agent does, in words. */
function achieved({ status, world }) {
  if (status.objectives.length === 0) return "";
  const counts = world.objectives.map((name, i) => `${plain(name)} ${status.objectives[i].toFixed(1)}`);
  return `The agent's last episodes, on average: ${counts.join(", ")}.`;
}
