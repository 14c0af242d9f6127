/**
 * The page of a live session: connects, chooses the view, and hands it keys and news.
 *
 * `window.moral.drawn()` tells what is drawn at this moment and nothing else: `state` (what the page is doing),
 * `query`, `playing`, `frames` (pictures drawn while playing) and, for `left` and `right`, the `moment` in steps
 * and the `things` with their `pattern`, `row` and `column`. How long answers took to be recorded is in the
 * browser's own `performance.getEntriesByName("moral: answer recorded")`.
 */

import { Compare, HELP as COMPARE_HELP } from "./compare.js";
import { drawKey, follow, newerQueue, request } from "./connection.js";
import { Demonstrate, HELP as DEMONSTRATE_HELP } from "./demonstrate.js";
import { Panel } from "./panel.js";

const $ = (selector) => document.querySelector(selector);

const state = { offline: false, ended: false, connected: false };
let view = null;
let panel = null;

const page = {
  /** Have a screen reader say something. */
  announce(text) {
    $("#announce").textContent = text;
  },

  /** Show a message in place of the episodes, or none (null). */
  message(message) {
    const box = $("#message");
    box.hidden = message === null;
    if (message === null) return;
    setText(box.querySelector(".title"), message.title);
    setText(box.querySelector(".detail"), message.detail ?? "");
    box.classList.toggle("busy", message.busy === true);
    box.classList.toggle("done", message.done === true);
    const bar = box.querySelector("progress");
    bar.hidden = message.progress === undefined;
    if (!bar.hidden) bar.value = message.progress;
    const action = $("#message-action");
    action.hidden = message.action === undefined;
    setText(action, message.action ?? "");
  },

  /** Accept the notice of the study. */
  async agree() {
    try {
      await request("api/consent", { key: drawKey() });
      state.consent = { ...state.consent, given: true };
      update();
    } catch (error) {
      page.announce(error.message);
    }
  },
};

/** Only what is new is written, so that a screen reader does not say the same again. */
function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

function update() {
  if (state.mode && !view) {
    document.body.dataset.mode = state.mode;
    view = state.mode === "answer" ? new Compare(page) : new Demonstrate(page);
    panel = state.mode === "answer" ? new Panel() : null;
    layHelp(state.mode === "answer" ? COMPARE_HELP : DEMONSTRATE_HELP);
  }
  const lamp = state.ended ? "ended" : state.offline ? "lost" : state.mode ? "on" : "connecting";
  $("#connection").dataset.lamp = lamp;
  setText($("#connection .text"), { ended: "Ended", lost: "Reconnecting", on: "Connected", connecting: "Connecting" }[lamp]);
  if (view) {
    view.update(state);
    panel?.update(state);
  } else if (state.ended) {
    page.message({ title: "This session has ended", detail: "To go on, open the link that the new session printed." });
  }
}

function layHelp(rows) {
  $("#help-keys").replaceChildren(
    ...[...rows, ["H", "this help"]].map(([keys, text]) => {
      const row = document.createElement("div");
      const [term, meaning] = [document.createElement("dt"), document.createElement("dd")];
      term.textContent = keys;
      meaning.textContent = text;
      row.append(term, meaning);
      return row;
    }),
  );
}

function toggleHelp() {
  const dialog = $("#help-dialog");
  if (dialog.open) dialog.close();
  else dialog.showModal();
}

$("#help").addEventListener("click", toggleHelp);
$("#help-close").addEventListener("click", toggleHelp);

document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.key === "h" || event.key === "H" || event.key === "?") {
    toggleHelp();
    event.preventDefault();
  } else if (!$("#help-dialog").open && view?.key(event)) {
    event.preventDefault();
  }
});

window.moral = Object.freeze({ drawn: () => view?.drawn() ?? { state: document.body.dataset.state } });

page.message({ title: "Connecting", detail: "One moment, please.", busy: true });
follow({
  event(name, value) {
    const { queue } = state;
    Object.assign(state, name === "state" ? value : { [name]: value });
    state.queue = newerQueue(queue, state.queue);
    state.offline = false;
    update();
  },
  lost() {
    state.offline = true;
    update();
  },
  ended() {
    state.ended = true;
    update();
  },
});
