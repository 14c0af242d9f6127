"""Training and answering are killed at random moments, together, and go on as if nothing had happened."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np

from moral_algorithms.answers import read_answers
from moral_algorithms.query_folder import QueryFolder
from moral_algorithms.run_directory import read_lines
from moral_algorithms.storage import read_json

KILLS = 20

# A person and a training in one process, which is forked for every attempt, so that PyTorch is imported once.
# Each attempt kills itself when it is about to flush a file for the n-th time: there is no clock in it. What
# was acknowledged to the person is written down before the next flush.
SCRIPT = """
import json, os, signal, sys
from pathlib import Path

import numpy as np
import torch

from moral_algorithms.bridge import PrimaryReward
from moral_algorithms.learners.moral import train_moral
from moral_algorithms.learners.query_queue import People
from moral_algorithms.live.session import LiveSession
from moral_algorithms.run_directory import RunDirectory
from tests.algorithms.learners.test_moral import NORMALISERS, config
from tests.algorithms.live.runs import WORLD
from tests.algorithms.tiny import EMERGENCY

torch.set_num_threads(1)
run, acknowledged = Path(sys.argv[1]), Path(sys.argv[2])
moments = json.loads(sys.argv[3])
flush = os.fsync


def attempt(moment):
    flushes = 0

    def flush_or_die(handle):
        nonlocal flushes
        flushes += 1
        if flushes == moment:
            os.kill(os.getpid(), signal.SIGKILL)
        flush(handle)

    os.fsync = flush_or_die
    session = LiveSession(run, "ada")
    rng = np.random.default_rng(os.getpid())

    def person(progress):
        queue = session.queue()
        for entry in queue["open"][:1]:
            number = entry["query"]
            key = f"key-{number}-{rng.integers(10**9)}"
            said = ["first", "second", "equal"][number % 3]
            session.answer(number, said, 1.0, key)
            with acknowledged.open("a") as file:
                file.write(json.dumps([number, said, key]) + "\\n")
            if number % 4 == 3 and f"undone-{number}" not in acknowledged.read_text():
                session.undo(number, f"undone-{number}")
                with acknowledged.open("a") as file:
                    file.write(json.dumps([number, "undo", f"undone-{number}"]) + "\\n")

    components = [PrimaryReward(WORLD.reward_names, name, 1 / value) for name, value in NORMALISERS.items()]
    settings = config(steps=1536, queries=12, checkpoint_every=2, candidates=20, samples=20)
    directory = RunDirectory(run)
    train_moral(EMERGENCY, components, People(), settings, 0, directory, on_progress=person, resume=True)
    (run / "done").touch()
    os._exit(0)


killed = 0
for moment in [*moments, 0]:
    child = os.fork()
    if child == 0:
        try:
            attempt(moment)
        finally:
            os._exit(3)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    killed += status == -9
    if status not in (0, -9):
        sys.exit(f"an attempt ended with {status}")
    if status == 0:
        break
print(killed)
"""


def test_every_acknowledged_answer_is_there_once_after_kills_at_random_moments(tmp_path: Path) -> None:
    run, acknowledged = tmp_path / "run", tmp_path / "acknowledged"
    acknowledged.touch()
    run.mkdir()
    config = {"format_version": 1, "kind": "train", "moral": {"queries": 12}}
    world = {"name": "emergency", "rules": {"height": 5, "width": 5, "num_people": 2, "max_cycles": 8}}
    (run / "config.json").write_text(json.dumps({**config, "world": world}))
    moments = np.random.default_rng(0).integers(1, 13, size=KILLS).tolist()
    script = [sys.executable, "-c", SCRIPT, str(run), str(acknowledged), json.dumps(moments)]
    done = subprocess.run(script, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) == KILLS
    assert (run / "done").exists()

    lines = read_lines(run / "queries.jsonl")
    keys = [line["key"] for line in lines]
    assert len(set(keys)) == len(keys)
    told = [json.loads(line) for line in acknowledged.read_text().splitlines()]
    # Acknowledged, so there, once, and as it was said.
    by_key = {line["key"]: line for line in lines}
    for number, said, key in told:
        assert by_key[key]["query"] == number
        assert by_key[key].get("preference", "undo") == said
    answers = read_answers(run / "queries.jsonl")
    assert len(answers.informative) == 12
    assert any(line["record"] == "undo" for line in lines)

    # Training has used the answers that stand, went on from where it was, and every query was posted before.
    rollouts = [line["env_steps"] for line in read_lines(run / "metrics.jsonl")]
    assert rollouts == list(range(64, rollouts[-1] + 1, 64))
    assert read_json(run / "status.json")["answers"] == 12
    assert set(answers.standing) <= set(QueryFolder(run).numbers())
