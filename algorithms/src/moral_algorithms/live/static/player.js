/** A clock that runs through the steps of an episode: play, pause, scrub, speed. */

const STEPS_PER_SECOND = 8;
const SPEEDS = [1, 2, 4, 0.5];

/** How long the start is held, in steps, so that the eye finds the agent before it leaves. */
const HOLD = 4;

export class Player {
  /** @param {(moment: number) => void} onMoment Draws the moment, in steps from the start. */
  constructor(onMoment) {
    this.onMoment = onMoment;
    this.steps = 0;
    this.moment = 0;
    this.playing = false;
    this.speed = SPEEDS[0];
    /** Pictures drawn while playing. */
    this.frames = 0;
  }

  /** Take an episode of so many steps; it begins at its start, or at its end where motion is unwelcome. */
  load(steps, { autoplay }) {
    this.pause();
    this.steps = steps;
    this.seek(autoplay ? 0 : steps);
    if (autoplay) this.play(HOLD);
  }

  play(hold = 0) {
    if (this.playing || this.steps === 0) return;
    if (this.moment >= this.steps) this.moment = 0;
    this.playing = true;
    let before = null;
    let ahead = -hold;
    const frame = (now) => {
      if (!this.playing) return;
      const passed = before === null ? 0 : ((now - before) / 1000) * STEPS_PER_SECOND * this.speed;
      before = now;
      ahead += passed;
      if (ahead > 0) {
        this.moment = Math.min(this.moment + Math.min(ahead, passed), this.steps);
        this.frames += 1;
      }
      if (this.moment >= this.steps) this.playing = false;
      this.onMoment(this.moment);
      if (this.playing) requestAnimationFrame(frame);
    };
    this.onMoment(this.moment);
    requestAnimationFrame(frame);
  }

  pause() {
    if (!this.playing) return;
    this.playing = false;
    this.onMoment(this.moment);
  }

  toggle() {
    if (this.playing) this.pause();
    else this.play();
  }

  /** Show a moment. */
  seek(moment) {
    this.moment = Math.max(0, Math.min(moment, this.steps));
    this.onMoment(this.moment);
  }

  /** Stop and show a moment. */
  jump(moment) {
    this.pause();
    this.seek(moment);
  }

  /** Stop and go so many steps on, or back. */
  step(count) {
    this.jump(count > 0 ? Math.floor(this.moment + 1e-9) + count : Math.ceil(this.moment - 1e-9) + count);
  }

  /** Take the next speed. */
  nextSpeed() {
    this.speed = SPEEDS[(SPEEDS.indexOf(this.speed) + 1) % SPEEDS.length];
    return this.speed;
  }
}
