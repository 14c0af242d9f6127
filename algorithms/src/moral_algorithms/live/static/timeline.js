/** The events of two episodes, one lane above the other, on one axis of time. */

import { plain } from "./episode.js";
import { icon } from "./tiles.js";

const ICON = 18;

/**
 * Fill the lanes.
 *
 * Every mark is an element with the data attributes `objective`, `from` and `to`; a run of steps in a row is
 * one bar.
 *
 * @param {HTMLElement} lanes
 * @param {object[]} episodes Left and right, or a single one.
 */
export function drawLanes(lanes, episodes) {
  const steps = Math.max(...episodes.map((episode) => episode.steps), 1);
  const at = (step) => `${(100 * step) / steps}%`;
  lanes.replaceChildren(
    ...episodes.map((episode, number) => {
      const lane = document.createElement("div");
      lane.className = `lane ${number === 0 ? "left" : "right"}`;
      for (const { objective, pattern, from, to } of episode.marks) {
        const mark = document.createElement("span");
        mark.title = from === to ? `${plain(objective)}, step ${from}` : `${plain(objective)}, steps ${from} to ${to}`;
        Object.assign(mark.dataset, { objective, from, to });
        mark.className = from === to ? "mark" : "mark run";
        mark.style.left = from === to ? at(from) : at(from - 1);
        if (from !== to) mark.style.width = at(to - from + 1);
        const picture = document.createElement("img");
        picture.src = icon(pattern, ICON);
        picture.alt = "";
        mark.append(picture);
        lane.append(mark);
      }
      return lane;
    }),
  );
  const head = document.createElement("div");
  head.className = "head";
  lanes.append(head);
}

/** Move the line that says which moment is shown. */
export function moveHead(lanes, moment, steps) {
  const head = lanes.querySelector(".head");
  if (head) head.style.left = `${(100 * moment) / Math.max(steps, 1)}%`;
}
