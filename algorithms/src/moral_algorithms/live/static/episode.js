/** What the server tells of an episode, made ready to be drawn. */

/** A name of the worlds as words: "people_saved" is "people saved". */
export const plain = (name) => name.replaceAll("_", " ");

/**
 * @typedef {object} Thing
 * @property {string} kind
 * @property {string} pattern How it is drawn.
 * @property {[number, number]} cell Row and column.
 * @property {number} from The step after which it is there first: those that walk are told anew in every cell.
 * @property {?number} gone The first step after which it is not there any more, or null.
 * @property {?string} becomes What is left of it.
 *
 * @typedef {object} Mark
 * @property {string} objective
 * @property {string} pattern
 * @property {number} from The step that brought it.
 * @property {number} to The same, or the last of a run of steps in a row.
 */

/**
 * Read an EPISODE of the protocol.
 *
 * @param {object} raw
 * @param {object} world The protocol's WORLD.
 * @returns {{height: number, width: number, steps: number, walls: string[], cells: [number, number][],
 *   actions: number[], fixture: ?{pattern: string, row: number, column: number}, things: Thing[],
 *   marks: Mark[], counters: number[][]}}
 */
export function readEpisode(raw, world) {
  const fixture = raw.fixture && {
    pattern: world.fixture.pattern,
    row: raw.fixture[0],
    column: raw.fixture[1],
  };
  const things = raw.things.map((thing) => readThing(thing, world));
  return {
    height: raw.walls.length,
    width: raw.walls[0].length,
    steps: raw.steps,
    walls: raw.walls,
    cells: raw.agent,
    actions: raw.actions,
    fixture,
    things,
    marks: readMarks(raw.events, things, fixture),
    counters: raw.counters,
  };
}

/** Read one thing of an EPISODE or a PLAY. */
export function readThing({ kind, cell, from, gone }, world) {
  const { pattern } = world.kinds.find(({ name }) => name === kind);
  // Nothing but a step onto it makes a vase disappear.
  const becomes = pattern === "vase" ? "shards" : null;
  return { kind, pattern, cell, from: from ?? 0, gone: gone ?? null, becomes };
}

function readMarks(events, things, fixture) {
  const marks = [];
  for (const { step, objective, cell } of events) {
    const thing = things.find((other) => other.gone === step && same(other.cell, cell));
    if (thing) {
      marks.push({ objective, pattern: thing.becomes ?? thing.pattern, from: step, to: step });
      continue;
    }
    const run = marks.findLast((mark) => mark.objective === objective);
    if (run?.to === step - 1) run.to = step;
    else marks.push({ objective, pattern: fixture?.pattern ?? "goal", from: step, to: step });
  }
  return marks;
}

const same = (one, other) => one[0] === other[0] && one[1] === other[1];

/** The events of an episode in words, for who does not see the picture. */
export function describe({ marks, steps }) {
  const times = new Map();
  for (const { objective, from, to } of marks) {
    const time = from === to ? `${from}` : `${from} to ${to}`;
    times.set(objective, [...(times.get(objective) ?? []), time]);
  }
  const parts = [...times].map(([objective, when]) => `${plain(objective)} at step ${when.join(", ")}`);
  return `${steps} steps. ${parts.length > 0 ? parts.join("; ") : "Nothing happens"}.`;
}
