"""The command line: ``moral COMMAND``.

A command is a module of this package with a dataclass ``Command``: its fields are the options, its docstring
is the help, and ``execute`` does the work. It is imported only when it is asked for, because PyTorch takes
seconds to import.
"""

from __future__ import annotations

import importlib
import os
import signal
import sys
import time
from collections.abc import Sequence
from importlib.metadata import version

# What a command takes includes the imports that follow.
_STARTED = time.perf_counter()

from moral_algorithms.cli.arguments import BaseCommand, parse  # noqa: E402
from moral_algorithms.cli.console import Console, end_with_reader, uninterrupted  # noqa: E402

__all__ = ["COMMANDS", "main"]

COMMANDS = {
    "demo": "from nothing to an aligned agent in Emergency, in a minute or two",
    "expert": "train an expert with PPO on known weights",
    "demonstrate": "record episodes of an expert",
    "airl": "learn a reward network from demonstrations",
    "train": "MORAL: train under weights that are learned from pairwise preferences",
    "cover": "train one policy for all weights, so that queries need no more training",
    "align": "ask a teacher about such a policy until the weights are known",
    "live": "MORAL with you as the teacher, who answers on a web page",
    "replay": "measure how consistent answers are, and train again from them alone",
    "drlhp": "the baseline: train under a reward that is learned from pairwise preferences alone",
    "evaluate": "measure a policy, in Emergency beside the exact optimum",
    "watch": "play an episode of a policy into a GIF or an MP4",
}
"""What each command does, by name."""

_HELP = """usage: moral [-h] [--version] COMMAND [OPTIONS]

Multi-Objective Reinforced Active Learning: agents that balance rewards learned from
demonstrations with rewards they are given, by asking for pairwise preferences.

commands:
{commands}

`moral COMMAND --help` explains a command and its options. Start with `moral demo`.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command.

    Parameters
    ----------
    arguments
        What follows ``moral``; by default that of the process.

    Returns
    -------
    int
        Exit status: 0; 2 after bad input, unknown, missing or malformed options, or where a file cannot be
        read or written, which one line on stderr explains; 130 after an interruption; 1 where the reader of
        its output has gone, as ``head`` does.

    Raises
    ------
    SystemExit
        After a command's help (0).
    """
    console = Console(_STARTED if arguments is None else None)
    if arguments is None:
        _let_threads_sleep()
    name, *options = list(sys.argv[1:] if arguments is None else arguments) or ["--help"]
    status = end_with_reader(lambda: _run(name, options, console))
    if arguments is None:
        # All is said and saved; to Ctrl-C while it ends, Python would answer with a traceback.
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    return status


def _let_threads_sleep() -> None:
    """Have PyTorch's threads, which are not there yet, wait for each other asleep after a short while.

    By default they spin until the last is done. Where another program has the core of one, they then hold it
    up themselves: training on two threads became several times slower.
    """
    if not {"GOMP_SPINCOUNT", "OMP_WAIT_POLICY"} & os.environ.keys():
        os.environ["GOMP_SPINCOUNT"] = "2000"


def _run(name: str, options: Sequence[str], console: Console) -> int:
    if name in ("-h", "--help"):
        width = max(map(len, COMMANDS))
        lines = "\n".join(f"  {command:{width}}  {text}" for command, text in COMMANDS.items())
        print(_HELP.format(commands=lines), end="")
        return 0
    if name == "--version":
        print(f"moral {version('moral-algorithms')}")
        return 0
    command: BaseCommand | None = None
    try:
        if name not in COMMANDS:
            raise ValueError(f"command is {name!r}; it must be one of {', '.join(COMMANDS)}")
        module = importlib.import_module(f"moral_algorithms.cli.{name}")
        command = parse(module.Command, options, f"moral {name}")
        command.execute(console)
    except KeyboardInterrupt:
        # Who presses it twice is to read it all the same.
        with uninterrupted():
            console.error("moral: interrupted" if command is None else f"moral: interrupted; {command.hint}")
        return 130
    except BrokenPipeError:
        raise
    except (ValueError, OSError) as error:
        console.error(f"moral: error: {error}")
        return 2
    except MemoryError as error:
        console.error(f"moral: error: there is not enough memory: {error}")
        return 2
    return 0
