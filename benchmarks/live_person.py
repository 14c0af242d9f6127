"""A scripted person in front of `moral live`: what the answers lead to, and what the page costs.

    python -m benchmarks.live_person

The person looks at each question for some seconds, judges by what the page has drawn and answers by the
keyboard. Nothing else of the session is looked at: fewer people left in the picture is better and, on a tie,
a longer bar at the extinguisher in the time line. The results file holds

- what the trained agent does on 1,000 seeded starts,
- the time from a key to the acknowledgement that the answer is on the disk,
- the pictures a second while both episodes play and the agent trains,
- in a session of its own that nobody answers, training's speed in turns with the page open and playing, and
  without it.

It needs a Chromium and Playwright; times mean something on an idle machine.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.chromium import chromium
from benchmarks.provenance import provenance
from moral_algorithms.storage import write_json

RESULTS = Path(__file__).parent / "results" / "live_person.json"

_COMMAND = (sys.executable, "-c", "from moral_algorithms.cli import main; raise SystemExit(main())")
_LINK = re.compile(rb"http://\S+/\?token=\S+")
_SCREEN = {"width": 1280, "height": 720}
# Milliseconds within which a question or the end must come.
_PATIENCE = 600_000

_LOOK = """() => {
    const people = (side) => side.things.filter(({ pattern }) => pattern === "person").length;
    const bars = (side) => [...document.querySelectorAll(`.lane.${side} .mark[data-objective=goal_time]`)]
        .reduce((sum, { dataset }) => sum + Number(dataset.to) - Number(dataset.from) + 1, 0);
    const { left, right } = window.moral.drawn();
    return { left: [-people(left), bars("left")], right: [-people(right), bars("right")] };
}"""


def main(options: Sequence[str] | None = None) -> None:
    """Run it and report."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rewards", type=Path, help="run directory of moral airl; without it one is made")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--queries", type=int, default=25)
    parser.add_argument("--look", type=float, default=2.0, help="seconds that the person looks at a question")
    parser.add_argument("--windows", type=int, default=12, help="turns of each kind for training's speed")
    parser.add_argument("--window", type=float, default=4.0, help="seconds of a turn")
    parser.add_argument("--json", type=Path, default=RESULTS, help="file for the results")
    arguments = parser.parse_args(options)
    for name, least in (("seed", 0), ("queries", 1), ("look", 0.2), ("windows", 1), ("window", 0.2)):
        # Not so for nan, either.
        if not getattr(arguments, name) >= least:
            parser.error(f"{name} is {getattr(arguments, name)}; it must be at least {least}")
    started = time.perf_counter()
    with tempfile.TemporaryDirectory() as name, chromium() as browser:
        folder = Path(name)
        rewards = arguments.rewards or learn_to_save(folder, arguments.seed)
        session = ("--rewards", rewards, "--seed", arguments.seed, "--queries", arguments.queries)
        with live(folder / "answered", *session) as link:
            answered = answer_all(browser, link, arguments.queries, arguments.look)
        answered["objectives"] = evaluate(folder / "answered")
        with live(folder / "unanswered", *session) as link:
            speed = training_speed(browser, link, arguments.windows, arguments.window)
    results = {
        "command": "python -m benchmarks.live_person",
        "seed": arguments.seed,
        "queries": arguments.queries,
        "look_seconds": arguments.look,
        "load_average": os.getloadavg(),
        **provenance(started),
        **answered,
        "training_speed": speed,
    }
    report(results)
    write_json(arguments.json, results)


def learn_to_save(folder: Path, seed: int) -> Path:
    """Make what `moral live` starts from, as the demo does: an expert, its record and AIRL's reward."""
    run("expert", "--weights", 0, 1, "--seed", seed, "--out", folder / "expert")
    run("demonstrate", "--expert", folder / "expert", "--seed", seed, "--out", folder / "saving.npz")
    run("airl", "--demonstrations", folder / "saving.npz", "--seed", seed, "--out", folder / "airl")
    return folder / "airl"


def run(*arguments: object) -> bytes:
    """Run `moral` and return what it prints."""
    return subprocess.run([*_COMMAND, *map(str, arguments)], check=True, stdout=subprocess.PIPE).stdout


def evaluate(folder: Path) -> dict[str, float]:
    """Measure the agent on 1,000 seeded starts."""
    found = json.loads(run("evaluate", "--run", folder, "--json"))
    objectives: dict[str, float] = found["objectives"]
    return objectives


@contextmanager
def live(out: Path, *options: object) -> Iterator[str]:
    """Start `moral live`, yield its link, and interrupt it at the end as a person would.

    Raises
    ------
    RuntimeError
        If it ends by itself.
    """
    command = [*_COMMAND, "live", "--out", str(out), "--port", "0", *map(str, options)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, env={**os.environ, "COLUMNS": "300"})
    assert process.stdout is not None
    try:
        for line in process.stdout:
            if found := _LINK.search(line):
                yield found[0].decode()
                break
        else:
            raise RuntimeError(f"moral live ended with status {process.wait()}")
    finally:
        process.send_signal(signal.SIGINT)
        process.stdout.close()
        process.wait()


def answer_all(browser: Any, link: str, queries: int, look: float) -> dict[str, Any]:
    """Answer question after question until the training is finished.

    Parameters
    ----------
    browser
        Where the page is opened.
    link
        Of the session.
    queries
        How many answers it wants.
    look
        Seconds for which the episodes of each question play, at four times the speed.
    """
    page = browser.new_page(viewport=_SCREEN)
    page.goto(link)
    pictures: list[float] = []
    answers: list[str] = []
    seen = -1
    while len(answers) < queries:
        page.wait_for_function(
            "seen => document.body.dataset.state === 'question' && window.moral.drawn().query !== seen",
            arg=seen,
            timeout=_PATIENCE,
        )
        if not answers:
            page.keyboard.press("s")
            page.keyboard.press("s")
        pictures += frame_times(page, look)
        page.keyboard.press("End")
        seen = page.evaluate("() => window.moral.drawn().query")
        key = judge(**page.evaluate(_LOOK))
        page.keyboard.press(key)
        answers.append(key)
    page.wait_for_function("() => document.body.dataset.state === 'finished'", timeout=_PATIENCE)
    times = page.evaluate("() => performance.getEntriesByName('moral: answer recorded').map(e => e.duration)")
    page.context.close()
    if len(times) != queries:
        raise RuntimeError(f"{len(times)} of {queries} answers were acknowledged")
    return {
        "answers": {key: answers.count(key) for key in sorted(set(answers))},
        "milliseconds_to_recorded": quantiles(times),
        "milliseconds_between_pictures": quantiles(pictures),
        "pictures_per_second": 1000 / float(np.mean(pictures)),
    }


def judge(left: list[int], right: list[int]) -> str:
    """Choose the key: more is better, in the first figure and, on a tie, in the next."""
    if left == right:
        return "ArrowDown"
    return "ArrowLeft" if left > right else "ArrowRight"


def frame_times(page: Any, seconds: float) -> list[float]:
    """Milliseconds between pictures while the episodes play, again and again, for some seconds."""
    times: list[float] = page.evaluate(
        """async (milliseconds) => {
            const times = [];
            const start = performance.now();
            let [before, frames] = [null, null];
            while (performance.now() - start < milliseconds) {
                if (!window.moral.drawn().playing) {
                    document.querySelector("#play").click();
                    before = null;
                }
                const now = await new Promise(requestAnimationFrame);
                const drawn = window.moral.drawn().frames;
                if (before !== null && drawn > frames) times.push(now - before);
                if (before === null || drawn > frames) before = now;
                frames = drawn;
            }
            return times;
        }""",
        1000 * seconds,
    )
    return times


def training_speed(browser: Any, link: str, windows: int, seconds: float) -> dict[str, Any]:
    """Environment steps a second in turns: with the page open and playing, and without it."""
    speeds: dict[str, list[float]] = {"open": [], "closed": []}
    for turn in range(2 * windows):
        kind = "open" if turn % 2 == 0 else "closed"
        page = browser.new_page(viewport=_SCREEN)
        page.goto(link)
        page.wait_for_function("() => document.body.dataset.state === 'question'", timeout=_PATIENCE)
        state = f"{link.partition('?')[0]}api/state"
        cookies = page.context.request
        before, since = steps_so_far(cookies, state), time.perf_counter()
        if kind == "open":
            frame_times(page, seconds)
        else:
            page.goto("about:blank")
            time.sleep(seconds)
        steps, passed = steps_so_far(cookies, state) - before, time.perf_counter() - since
        speeds[kind].append(steps / passed)
        page.context.close()
    ratios = np.array(speeds["open"]) / speeds["closed"]
    return {
        "steps_per_second": {kind: quantiles(found) for kind, found in speeds.items()},
        "ratio_of_neighbours": quantiles(ratios.tolist()),
        "ratio_of_means": float(np.mean(speeds["open"]) / np.mean(speeds["closed"])),
    }


def steps_so_far(cookies: Any, address: str) -> int:
    """Ask how many environment steps the training has made, at the moment of its next status."""
    first = found = cookies.get(address).json()["status"]["env_steps"]
    while found == first:
        time.sleep(0.02)
        found = cookies.get(address).json()["status"]["env_steps"]
    return int(found)


def quantiles(values: Sequence[float]) -> dict[str, float]:
    """Median, 95th percentile, least and most."""
    return {
        "median": float(np.median(values)),
        "p95": float(np.quantile(values, 0.95)),
        "least": float(min(values)),
        "most": float(max(values)),
    }


def report(results: dict[str, Any]) -> None:
    """Print the figures beside what they are to be."""
    recorded, speed = results["milliseconds_to_recorded"], results["training_speed"]
    objectives = results["objectives"]
    rows = (
        ("people saved", f"{objectives['people_saved']:.2f}", ">= 5.9"),
        ("goal time", f"{objectives['goal_time']:.1f}", ">= 50"),
        ("key to recorded, p95", f"{recorded['p95']:.0f} ms", "< 100 ms"),
        ("pictures a second", f"{results['pictures_per_second']:.0f}", ">= 30"),
        ("speed with the page, of that without", f"{speed['ratio_of_means']:.2f}", ">= 0.85"),
    )
    for name, value, wanted in rows:
        print(f"{name:40}{value:>10}   {wanted}")


if __name__ == "__main__":
    main()
