/** One episode on a canvas, at any moment of it: the room, the things, the agent and its path. */

import { drawThing, drawWall } from "./tiles.js";

/** How much of the border wall is shown, in cells: it says where the room ends, no more. */
const BORDER = 0.45;

const [SPRAY, DROPS] = ["#3a8fd0", 7];

const MOVES = [[-1, 0], [1, 0], [0, -1], [0, 1]];
const FIRST_REACH = 5;

/** Left edge, top edge and size of the things that share a cell, by how many there are, from below to above. */
const LAYOUTS = {
  1: [[0, 0, 1]],
  2: [[0.02, 0.02, 0.6], [0.38, 0.38, 0.6]],
  3: [[0, 0, 0.52], [0.48, 0, 0.52], [0.24, 0.46, 0.52]],
};

const ease = (x) => x * x * (3 - 2 * x);

/** The way an action points, as [rows, columns]; null for waiting. */
function direction(action) {
  if (action < 4) return MOVES[action];
  return action >= FIRST_REACH ? MOVES[action - FIRST_REACH] : null;
}

/**
 * Draws episodes of one room size on one canvas.
 *
 * The canvas holds as many device pixels as it covers, so that the picture is sharp at every size and zoom.
 */
export class Stage {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {{dashed: boolean, colour: string}} path How the path looks; the colour is a CSS custom property.
   */
  constructor(canvas, path) {
    this.canvas = canvas;
    this.path = path;
    this.episode = null;
    this.moment = 0;
    this.smooth = true;
    this.ground = document.createElement("canvas");
    this.groundKey = "";
    new ResizeObserver(() => this.draw()).observe(canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
  }

  /** Show an episode, or nothing (null), from its start. */
  show(episode) {
    this.episode = episode;
    this.moment = 0;
    this.groundKey = "";
    if (episode) {
      const ratio = (episode.width - 2 + 2 * BORDER) / (episode.height - 2 + 2 * BORDER);
      this.canvas.style.setProperty("--ratio", ratio);
    }
    this.draw();
  }

  /** Draw the moment `moment`, in steps from the start; between two whole steps things are on their way. */
  seek(moment) {
    this.moment = moment;
    this.draw();
  }

  draw() {
    const { canvas, episode } = this;
    const scale = window.devicePixelRatio || 1;
    const [width, height] = [Math.round(canvas.clientWidth * scale), Math.round(canvas.clientHeight * scale)];
    if (width === 0 || height === 0) return;
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    const ctx = canvas.getContext("2d");
    ctx.setTransform(1, 0, 0, 1, 0, 0);
    ctx.clearRect(0, 0, width, height);
    if (!episode) return;
    const tile = width / (episode.width - 2 + 2 * BORDER);
    this.#paintGround(tile, width, height);
    ctx.drawImage(this.ground, 0, 0);
    // From here on a cell is one unit, and (0, 0) the corner of the border wall.
    ctx.scale(tile, tile);
    ctx.translate(BORDER - 1, BORDER - 1);
    this.#drawPath(ctx);
    this.#drawThings(ctx);
    this.#drawSpray(ctx);
  }

  /** What is drawn now: the position of everything, in cells, and the moment. */
  drawn() {
    if (!this.episode) return null;
    return {
      moment: this.moment,
      things: this.#things().map(({ pattern, row, column }) => ({ pattern, row, column })),
    };
  }

  #paintGround(tile, width, height) {
    const style = getComputedStyle(this.canvas);
    const colours = ["floor", "grid", "brick", "mortar"].map((name) => style.getPropertyValue(`--${name}`));
    const key = [width, height, ...colours].join(" ");
    if (key === this.groundKey) return;
    this.groundKey = key;
    const [floor, grid, brick, mortar] = colours;
    [this.ground.width, this.ground.height] = [width, height];
    const ctx = this.ground.getContext("2d");
    ctx.fillStyle = floor;
    ctx.fillRect(0, 0, width, height);
    ctx.translate((BORDER - 1) * tile, (BORDER - 1) * tile);
    this.episode.walls.forEach((line, row) => {
      [...line].forEach((cell, column) => {
        if (cell === "1") {
          drawWall(ctx, column * tile, row * tile, tile, { brick, mortar });
        } else {
          ctx.strokeStyle = grid;
          ctx.lineWidth = Math.max(1, tile / 40);
          ctx.strokeRect(column * tile, row * tile, tile, tile);
        }
      });
    });
  }

  /** The step that is under way (1, 2, ...; 0 at the start) and how much of it is done, 0 to 1. */
  #progress() {
    const { length } = this.episode.actions;
    const step = Math.min(this.smooth ? Math.ceil(this.moment) : Math.floor(this.moment), length);
    return [step, this.smooth ? ease(1 - (step - this.moment)) : 1];
  }

  #agent() {
    const { cells, actions } = this.episode;
    const [step, part] = this.#progress();
    const [row, column] = cells[step];
    if (step === 0) return { row, column, look: [0, 0] };
    const [fromRow, fromColumn] = cells[step - 1];
    const look = direction(actions[step - 1]) ?? [0, 0];
    // Reaching out, or bumping into a wall: there and back.
    const moved = row !== fromRow || column !== fromColumn;
    const lunge = moved || !this.smooth ? 0 : 0.22 * Math.sin(Math.PI * part);
    return {
      row: fromRow + (row - fromRow) * part + lunge * look[0],
      column: fromColumn + (column - fromColumn) * part + lunge * look[1],
      look,
    };
  }

  #drawPath(ctx) {
    const { episode } = this;
    const colour = getComputedStyle(this.canvas).getPropertyValue(this.path.colour);
    const moves = movesOf(episode);
    const last = this.#progress()[0];
    ctx.save();
    ctx.strokeStyle = ctx.fillStyle = colour;
    ctx.lineJoin = ctx.lineCap = "round";
    for (const [steps, alpha, width] of [[Infinity, 0.28, 0.07], [last, 1, 0.09]]) {
      ctx.globalAlpha = alpha;
      ctx.lineWidth = width;
      ctx.setLineDash(this.path.dashed ? [0.16, 0.17] : []);
      ctx.beginPath();
      for (const { step, from, to } of moves) {
        if (step > steps) break;
        const part = steps === last && step === last ? this.#progress()[1] : 1;
        ctx.lineTo(from[1] + 0.5, from[0] + 0.5);
        ctx.lineTo(from[1] + (to[1] - from[1]) * part + 0.5, from[0] + (to[0] - from[0]) * part + 0.5);
      }
      ctx.stroke();
    }
    ctx.restore();
    // Where it began: a hollow ring, which no thing of the worlds is.
    const [row, column] = episode.cells[0];
    ctx.save();
    ctx.strokeStyle = colour;
    ctx.lineWidth = 0.06;
    ctx.beginPath();
    ctx.arc(column + 0.5, row + 0.5, 0.17, 0, 2 * Math.PI);
    ctx.fillStyle = getComputedStyle(this.canvas).getPropertyValue("--floor");
    ctx.fill();
    ctx.stroke();
    ctx.restore();
  }

  #things() {
    const { episode } = this;
    const [step, part] = this.#progress();
    const things = [];
    if (episode.fixture) {
      const { pattern, row, column } = episode.fixture;
      things.push({ pattern, row, column, fade: 0 });
    }
    for (const { pattern, cell, from, gone, becomes } of episode.things) {
      if (step < from) continue;
      const [row, column] = cell;
      if (gone === null || step < gone) {
        // What walks arrives while it fades where it was.
        const fade = step > from || from === 0 ? 0 : Math.min(1, 2 - 2 * part);
        if (fade < 1) things.push({ pattern, row, column, fade });
      } else {
        // It is there until the step that takes it is half done.
        const fade = step > gone ? 1 : Math.max(0, 2 * part - 1);
        if (fade < 1) things.push({ pattern, row, column, fade });
        if (becomes && fade > 0) things.push({ pattern: becomes, row, column, fade: 0, below: true });
      }
    }
    const { row, column, look } = this.#agent();
    things.push({ pattern: "agent", row, column, look, fade: 0 });
    return things.sort((one, other) => (other.below === true) - (one.below === true));
  }

  #drawThings(ctx) {
    const things = this.#things();
    const agent = things.find(({ pattern }) => pattern === "agent");
    // A halo, so that the eye finds the agent among many things.
    ctx.globalAlpha = 0.16;
    ctx.fillStyle = getComputedStyle(this.canvas).getPropertyValue(this.path.colour);
    ctx.beginPath();
    ctx.arc(agent.column + 0.5, agent.row + 0.5, 0.7, 0, 2 * Math.PI);
    ctx.fill();
    ctx.globalAlpha = 1;
    const cellOf = ({ row, column }) => `${Math.round(row)} ${Math.round(column)}`;
    const shared = new Map();
    for (const thing of things) {
      if (thing.below || thing.fade > 0) continue;
      shared.set(cellOf(thing), [...(shared.get(cellOf(thing)) ?? []), thing]);
    }
    for (const thing of things) {
      const group = shared.get(cellOf(thing)) ?? [];
      const place = group.indexOf(thing);
      const [left, top, size] = place < 0 || !LAYOUTS[group.length] ? [0, 0, 1] : LAYOUTS[group.length][place];
      // Things make room smoothly as the agent comes near.
      const near = Math.max(0, 1 - Math.hypot(agent.row - thing.row, agent.column - thing.column) * 2);
      const weight = thing === agent ? 1 - 2 * Math.min(0.5, distanceToCell(agent)) : near;
      const inset = place < 0 || group.length === 1 ? 0 : weight;
      ctx.save();
      ctx.globalAlpha = 1 - thing.fade;
      drawThing(
        ctx,
        thing.pattern,
        thing.column + left * inset - 0.15 * thing.fade,
        thing.row + top * inset - 0.35 * thing.fade,
        1 + (size - 1) * inset + 0.3 * thing.fade,
        thing.look,
      );
      ctx.restore();
    }
  }

  /** Drops from an extinguisher while the agent stays with it. */
  #drawSpray(ctx) {
    const { fixture, cells } = this.episode;
    if (fixture?.pattern !== "extinguisher") return;
    const [step] = this.#progress();
    const stays = [cells[step], cells[Math.max(step - 1, 0)]].every(
      ([row, column]) => row === fixture.row && column === fixture.column,
    );
    if (!stays || step === 0) return;
    ctx.fillStyle = SPRAY;
    for (let drop = 0; drop < DROPS; drop += 1) {
      const flight = this.smooth ? (this.moment / 2 + drop / DROPS) % 1 : (drop + 0.5) / DROPS;
      const angle = Math.PI * (1.02 + 0.34 * ((drop * 0.618) % 1));
      const reach = 0.1 + 0.75 * flight;
      ctx.globalAlpha = 0.9 * (1 - flight);
      ctx.beginPath();
      ctx.arc(
        fixture.column + 0.16 + reach * Math.cos(angle),
        fixture.row + 0.12 + reach * Math.sin(angle) + 0.25 * flight * flight,
        0.035 + 0.03 * flight,
        0,
        2 * Math.PI,
      );
      ctx.fill();
    }
    ctx.globalAlpha = 1;
  }
}

const distanceToCell = ({ row, column }) => Math.hypot(row - Math.round(row), column - Math.round(column));

/** The moves of an episode, each beside the earlier ones between the same two cells. */
function movesOf({ cells }) {
  const passed = new Map();
  const moves = [];
  if (known.get(cells)?.length === cells.length) return known.get(cells).moves;
  known.set(cells, { length: cells.length, moves });
  for (let step = 1; step < cells.length; step += 1) {
    const [from, to] = [cells[step - 1], cells[step]];
    if (from[0] === to[0] && from[1] === to[1]) continue;
    const key = [from, to].map(String).sort().join(" ");
    const times = passed.get(key) ?? 0;
    passed.set(key, times + 1);
    const aside = LANES[times % LANES.length];
    const offset = from[0] === to[0] ? [aside, 0] : [0, aside];
    const shift = (cell) => [cell[0] + offset[0], cell[1] + offset[1]];
    moves.push({ step, from: shift(from), to: shift(to) });
  }
  return moves;
}

/** How far aside the first, second, ... move between two cells is drawn. */
const LANES = [0, 0.15, -0.15, 0.28, -0.28];

/** Moves that were found before; a played episode grows. */
const known = new WeakMap();
