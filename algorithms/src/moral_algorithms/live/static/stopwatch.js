/** Measures how long the person looked: while the page is hidden it stands still. */
export class Stopwatch {
  constructor() {
    this.passed = 0;
    this.since = null;
    document.addEventListener("visibilitychange", () => (document.hidden ? this.#halt() : this.#go()));
  }

  start() {
    this.passed = 0;
    this.since = document.hidden ? null : performance.now();
  }

  /** @returns {number} Seconds since the start. */
  read() {
    const running = this.since === null ? 0 : performance.now() - this.since;
    return Math.round(this.passed + running) / 1000;
  }

  #halt() {
    if (this.since !== null) this.passed += performance.now() - this.since;
    this.since = null;
  }

  #go() {
    this.since ??= performance.now();
  }
}
