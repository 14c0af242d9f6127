/** The posterior over the weights, and the objectives over the training. */

import { plain } from "./episode.js";

const SVG = "http://www.w3.org/2000/svg";

function svg(tag, attributes, ...children) {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

/** Width of a chart of the posterior, in its own units, and its least height. */
const [WIDTH, LEAST] = [320, 150];

/** About how wide a text is, in the same units. */
const wide = (text) => 7 * text.length;

const line = (points) => points.map(([x, y], i) => `${i ? "L" : "M"}${x.toFixed(1)} ${y.toFixed(1)}`).join("");
const percent = (part) => `${Math.round(100 * part)} %`;
const mean = (values) => values.reduce((sum, value) => sum + value, 0) / values.length;

function quantile(sorted, part) {
  const place = part * (sorted.length - 1);
  const [low, high] = [sorted[Math.floor(place)], sorted[Math.ceil(place)]];
  return low + (high - low) * (place - Math.floor(place));
}

/**
 * Draw the posterior over the weights: a density for two, a triangle for three, an interval each for more.
 *
 * @param {HTMLElement} box Where; what was drawn there before goes.
 * @param {string[]} names Of the components.
 * @param {number[][]} samples Each of sum 1.
 * @param {number[]} weights The mean.
 */
export function drawPosterior(box, names, samples, weights) {
  const draw = names.length === 2 ? density : names.length === 3 ? triangle : intervals;
  const words = names.map((name, i) => `${plain(name)} ${percent(weights[i])}`).join(", ");
  const height = Math.max(LEAST, (WIDTH * box.clientHeight) / Math.max(box.clientWidth, 1));
  box.replaceChildren(draw(names, samples, weights, height));
  box.setAttribute("role", "img");
  box.setAttribute("aria-label", `Weights that fit your answers, on average: ${words}.`);
}

function density(names, samples, weights, height) {
  const width = WIDTH;
  const top = 8;
  const floor = height - 34;
  const shares = samples.map((sample) => sample[1]);
  const spread = Math.sqrt(mean(shares.map((share) => (share - mean(shares)) ** 2)));
  const bandwidth = Math.max(0.012, spread * (4 / (3 * shares.length)) ** 0.2);
  const count = 161;
  const heights = Array.from({ length: count }, (_, i) => {
    const x = i / (count - 1);
    // Reflected at both ends, so that no mass is lost beyond them.
    return mean(shares.map((share) => kernel(x - share) + kernel(x + share) + kernel(2 - x - share)));
  });
  function kernel(distance) {
    return Math.exp(-0.5 * (distance / bandwidth) ** 2);
  }
  const peak = Math.max(...heights);
  const points = heights.map((y, i) => [(width * i) / (count - 1), floor - ((floor - top) * y) / peak]);
  const centre = width * weights[1];
  return svg(
    "svg",
    { viewBox: `-2 0 ${width + 4} ${height}`, class: "density", "aria-hidden": "true" },
    svg("path", { class: "area", d: `M0 ${floor}${line(points).replace("M", "L")}L${width} ${floor}Z` }),
    svg("path", { class: "edge", d: line(points) }),
    svg("path", { class: "axis", d: `M0 ${floor}H${width}` }),
    ...[0, 0.25, 0.5, 0.75, 1].map((x) => svg("path", { class: "axis", d: `M${width * x} ${floor}v4` })),
    svg("path", { class: "mean", d: `M${centre} ${top - 6}V${floor}` }),
    svg("path", { class: "pin", d: `M${centre} ${floor}l-6 9h12z` }),
    label(0, height - 9, `${plain(names[0])} ${percent(weights[0])}`, "start"),
    label(width, height - 9, `${percent(weights[1])} ${plain(names[1])}`, "end"),
  );
}

function triangle(names, samples, weights, height) {
  const width = WIDTH;
  const floor = height - 26;
  const side = Math.min(width - 90, (floor - 12) / Math.sqrt(0.75));
  const corners = [
    [width / 2 - side / 2, floor],
    [width / 2 + side / 2, floor],
    [width / 2, floor - side * Math.sqrt(0.75)],
  ];
  const place = (parts) => [0, 1].map((axis) => parts.reduce((sum, part, i) => sum + part * corners[i][axis], 0));
  const grid = [0.25, 0.5, 0.75].flatMap((part) =>
    [0, 1, 2].map((i) => {
      const ends = [1, 2].map((other) => {
        const parts = [0, 0, 0];
        parts[i] = part;
        parts[(i + other) % 3] = 1 - part;
        return place(parts);
      });
      return svg("path", { class: "grid", d: line(ends) });
    }),
  );
  const [x, y] = place(weights);
  const text = (i) => `${plain(names[i])} ${percent(weights[i])}`;
  // Beyond the corners, but never over each other.
  const start = (i) => Math.max(0, Math.min(corners[0][0] - 40, width / 2 - 6 - wide(text(i))));
  return svg(
    "svg",
    { viewBox: `0 0 ${width} ${height}`, class: "triangle", "aria-hidden": "true" },
    svg("path", { class: "outline", d: `${line(corners)}Z` }),
    ...grid,
    ...samples.map((sample) => {
      const [cx, cy] = place(sample);
      return svg("circle", { class: "sample", cx: cx.toFixed(1), cy: cy.toFixed(1), r: 2.2 });
    }),
    svg("path", { class: "pin", d: `M${x} ${y - 7}l7 7l-7 7l-7 -7z` }),
    label(start(0), height - 8, text(0), "start"),
    label(width - start(1), height - 8, text(1), "end"),
    label(Math.min(width / 2 + 12, width - wide(text(2))), corners[2][1] + 8, text(2), "start"),
  );
}

function intervals(names, samples, weights, height) {
  const [width, right] = [WIDTH, 272];
  const left = 10 + Math.max(94, ...names.map(wide));
  const row = height / names.length;
  const most = Math.max(0.05, ...samples.map((sample) => Math.max(...sample)));
  const at = (share) => left + ((right - left) * share) / most;
  return svg(
    "svg",
    { viewBox: `0 0 ${width} ${height}`, class: "intervals", "aria-hidden": "true" },
    ...names.flatMap((name, i) => {
      const sorted = samples.map((sample) => sample[i]).sort((one, other) => one - other);
      const [low, lower, upper, high] = [0.05, 0.25, 0.75, 0.95].map((part) => at(quantile(sorted, part)));
      const y = row * (i + 0.5);
      return [
        label(left - 10, y + 4, plain(name), "end"),
        svg("path", { class: "grid", d: `M${left} ${y}H${right}` }),
        svg("path", { class: "span", d: `M${low} ${y}H${high}` }),
        svg("path", { class: "middle", d: `M${lower} ${y}H${upper}` }),
        svg("path", { class: "pin", d: `M${at(weights[i])} ${y - 6}l6 6l-6 6l-6 -6z` }),
        label(width, y + 4, percent(weights[i]), "end"),
      ];
    }),
  );
}

function label(x, y, text, anchor) {
  return svg("text", { x, y, "text-anchor": anchor }, text);
}

/**
 * Draw how the objectives went over the training, a small curve each, with a tick under it for each answer.
 *
 * @param {HTMLElement} box
 * @param {string[]} names Of the objectives.
 * @param {{env_steps: number[], answers: number[], objectives: number[][]}} curves
 */
export function drawCurves(box, names, curves) {
  const [width, height] = [136, names.length > 2 ? 26 : 66];
  const last = Math.max(1, curves.env_steps.at(-1) ?? 1);
  const x = (steps) => (width * steps) / last;
  // A curve has no value before the first episode has ended.
  const known = curves.objectives.map((_, i) => i).filter((i) => curves.objectives[i].length > 0);
  const ticks = curves.answers
    .map((count, i) => (count > (curves.answers[i - 1] ?? 0) ? curves.env_steps[i] : null))
    .filter((steps) => steps !== null);
  box.replaceChildren(
    ...names.map((name, objective) => {
      const values = known.map((i) => curves.objectives[i][objective]);
      const most = Math.max(1, ...values);
      const points = known.map((i, j) => [x(curves.env_steps[i]), height - 5 - ((height - 9) * values[j]) / most]);
      const figure = document.createElement("figure");
      const caption = document.createElement("figcaption");
      const value = document.createElement("output");
      value.textContent = values.length > 0 ? values.at(-1).toFixed(1) : "–";
      caption.append(plain(name), " ", value);
      const end = points.at(-1);
      figure.append(
        caption,
        svg(
          "svg",
          { viewBox: `-1 0 ${width + 6} ${height}`, class: "curve", "aria-hidden": "true" },
          svg("path", { class: "axis", d: `M0 ${height - 4}H${width}` }),
          ...ticks.map((steps) => svg("path", { class: "tick", d: `M${x(steps).toFixed(1)} ${height - 4}v4` })),
          ...(points.length > 1 ? [svg("path", { class: "edge", d: line(points) })] : []),
          ...(end ? [svg("circle", { class: "end", cx: end[0].toFixed(1), cy: end[1].toFixed(1), r: 2.6 })] : []),
        ),
      );
      return figure;
    }),
  );
}
