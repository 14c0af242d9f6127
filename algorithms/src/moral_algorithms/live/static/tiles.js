/**
 * The things of the worlds, each drawn into a unit square whose origin is the top left corner.
 *
 * Every kind of thing has its own outline, so that no two are told apart by colour alone.
 */

const INK = "#262a32";

function shape(ctx, fill, line, trace) {
  ctx.beginPath();
  trace(ctx);
  ctx.fillStyle = fill;
  ctx.fill();
  if (line > 0) {
    ctx.lineWidth = line;
    ctx.stroke();
  }
}

const disc = (x, y, halfWidth, halfHeight = halfWidth) => (ctx) =>
  ctx.ellipse(x, y, halfWidth, halfHeight, 0, 0, 2 * Math.PI);

const box = (left, top, right, bottom, radius = 0) => (ctx) =>
  ctx.roundRect(left, top, right - left, bottom - top, radius);

function person(ctx) {
  shape(ctx, "#e69f00", 0.045, (c) => {
    c.moveTo(0.2, 0.88);
    c.bezierCurveTo(0.2, 0.58, 0.34, 0.5, 0.5, 0.5);
    c.bezierCurveTo(0.66, 0.5, 0.8, 0.58, 0.8, 0.88);
    c.closePath();
  });
  shape(ctx, "#f2c9a0", 0.045, disc(0.5, 0.3, 0.175));
}

function parcel(ctx) {
  shape(ctx, "#b8854f", 0.045, box(0.15, 0.22, 0.85, 0.86, 0.03));
  shape(ctx, "#e8cea4", 0, box(0.42, 0.245, 0.58, 0.58));
  shape(ctx, INK, 0, box(0.17, 0.41, 0.83, 0.44));
}

function pollution(ctx) {
  // The outline first, so that the lobes read as one puddle.
  const lobes = [disc(0.5, 0.68, 0.36, 0.19), disc(0.31, 0.53, 0.17), disc(0.56, 0.42, 0.2), disc(0.73, 0.58, 0.16)];
  for (const lobe of lobes) shape(ctx, INK, 0.09, lobe);
  for (const lobe of lobes) shape(ctx, "#6d7a4c", 0, lobe);
  for (const [x, y, radius] of [[0.34, 0.56, 0.06], [0.56, 0.43, 0.075], [0.64, 0.68, 0.065], [0.46, 0.72, 0.04]]) {
    shape(ctx, "#d3dcb8", 0, disc(x, y, radius));
  }
}

function vaseBody(c) {
  c.moveTo(0.34, 0.15);
  c.lineTo(0.66, 0.15);
  c.lineTo(0.66, 0.22);
  c.lineTo(0.58, 0.24);
  c.bezierCurveTo(0.58, 0.36, 0.78, 0.42, 0.78, 0.6);
  c.bezierCurveTo(0.78, 0.76, 0.68, 0.82, 0.64, 0.88);
  c.lineTo(0.36, 0.88);
  c.bezierCurveTo(0.32, 0.82, 0.22, 0.76, 0.22, 0.6);
  c.bezierCurveTo(0.22, 0.42, 0.42, 0.36, 0.42, 0.24);
  c.lineTo(0.34, 0.22);
  c.closePath();
}

function vase(ctx) {
  shape(ctx, "#1f93a0", 0.045, vaseBody);
  shape(ctx, "#c4ecec", 0, (c) => {
    c.moveTo(0.232, 0.54);
    c.lineTo(0.768, 0.54);
    c.lineTo(0.77, 0.66);
    c.lineTo(0.23, 0.66);
    c.closePath();
  });
}

function shards(ctx) {
  const pieces = [
    [[0.14, 0.86], [0.2, 0.56], [0.42, 0.72], [0.36, 0.88]],
    [[0.44, 0.88], [0.5, 0.66], [0.68, 0.6], [0.66, 0.88]],
    [[0.72, 0.86], [0.76, 0.66], [0.9, 0.84]],
    [[0.3, 0.46], [0.44, 0.3], [0.5, 0.52]],
    [[0.58, 0.46], [0.72, 0.26], [0.78, 0.46]],
  ];
  for (const piece of pieces) {
    shape(ctx, "#1f93a0", 0.045, (c) => {
      piece.forEach(([x, y]) => c.lineTo(x, y));
      c.closePath();
    });
  }
}

function extinguisher(ctx) {
  ctx.save();
  ctx.lineWidth = 0.075;
  ctx.beginPath();
  ctx.moveTo(0.54, 0.2);
  ctx.bezierCurveTo(0.86, 0.14, 0.84, 0.4, 0.83, 0.5);
  ctx.stroke();
  ctx.restore();
  shape(ctx, INK, 0, box(0.765, 0.46, 0.895, 0.7, 0.02));
  shape(ctx, "#9aa1ac", 0.03, box(0.4, 0.16, 0.54, 0.36));
  shape(ctx, INK, 0, box(0.26, 0.08, 0.6, 0.165, 0.03));
  shape(ctx, "#d0282c", 0.045, box(0.26, 0.3, 0.68, 0.92, [0.17, 0.17, 0.04, 0.04]));
  shape(ctx, "#ffffff", 0, box(0.283, 0.54, 0.657, 0.73));
}

function goal(ctx) {
  shape(ctx, INK, 0, disc(0.27, 0.9, 0.17, 0.06));
  shape(ctx, INK, 0, box(0.23, 0.08, 0.3, 0.9, 0.02));
  shape(ctx, "#ffffff", 0.04, box(0.29, 0.1, 0.91, 0.6));
  for (let row = 0; row < 3; row += 1) {
    for (let column = row % 2; column < 4; column += 2) {
      const [left, top] = [0.29 + 0.155 * column, 0.1 + (0.5 / 3) * row];
      shape(ctx, INK, 0, box(left, top, left + 0.155, top + 0.5 / 3));
    }
  }
}

function agent(ctx, [lookDown, lookRight] = [0, 0]) {
  ctx.save();
  ctx.lineWidth = 0.055;
  ctx.beginPath();
  ctx.moveTo(0.5, 0.22);
  ctx.lineTo(0.5, 0.1);
  ctx.stroke();
  ctx.restore();
  shape(ctx, "#f0e442", 0.035, disc(0.5, 0.085, 0.055));
  shape(ctx, INK, 0, box(0.07, 0.44, 0.93, 0.66, 0.06));
  shape(ctx, "#0072b2", 0.05, box(0.165, 0.2, 0.835, 0.88, 0.13));
  for (const x of [0.35, 0.65]) {
    shape(ctx, "#ffffff", 0, disc(x, 0.43, 0.115));
    shape(ctx, INK, 0, disc(x + 0.045 * lookRight, 0.435 + 0.045 * lookDown, 0.056));
  }
  shape(ctx, "#ffffff", 0, box(0.33, 0.67, 0.67, 0.74, 0.035));
}

const PAINT = { person, box: parcel, pollution, vase, shards, extinguisher, goal, agent };

/**
 * Draw one thing.
 *
 * @param {CanvasRenderingContext2D} ctx
 * @param {string} pattern One of person, box, pollution, vase, shards, extinguisher, goal, agent.
 * @param {number} left Left edge, in the context's units.
 * @param {number} top Top edge.
 * @param {number} size Width and height.
 * @param {[number, number]=} look Where an agent looks: rows down and columns right, -1 to 1.
 */
export function drawThing(ctx, pattern, left, top, size, look) {
  ctx.save();
  ctx.translate(left, top);
  ctx.scale(size, size);
  ctx.strokeStyle = INK;
  ctx.lineJoin = "round";
  ctx.lineCap = "round";
  PAINT[pattern](ctx, look);
  ctx.restore();
}

/** Draw a wall's bricks into the square of one cell. */
export function drawWall(ctx, left, top, size, { brick, mortar }) {
  ctx.fillStyle = mortar;
  ctx.fillRect(left, top, size, size);
  ctx.fillStyle = brick;
  const gap = Math.max(1, size * 0.05);
  const course = size / 3;
  for (let row = 0; row < 3; row += 1) {
    const joints = row % 2 === 0 ? [0, 0.5, 1] : [0, 0.25, 0.75, 1];
    for (let number = 0; number + 1 < joints.length; number += 1) {
      const [from, to] = [joints[number] * size, joints[number + 1] * size];
      // A half brick goes on in the next cell, without a joint at the border.
      const right = to === size && row % 2 === 1 ? to : to - gap;
      ctx.fillRect(left + from, top + row * course, right - from, course - gap);
    }
  }
}

/**
 * A picture of one thing for lists and time lines, made once for each pattern and size.
 *
 * @param {string} pattern
 * @param {number} size In CSS pixels.
 * @returns {string} A data URL.
 */
export function icon(pattern, size) {
  const key = `${pattern} ${size}`;
  if (!icons.has(key)) {
    const canvas = document.createElement("canvas");
    const scale = 2;
    canvas.width = canvas.height = size * scale;
    drawThing(canvas.getContext("2d"), pattern, 0, 0, size * scale);
    icons.set(key, canvas.toDataURL());
  }
  return icons.get(key);
}

const icons = new Map();
